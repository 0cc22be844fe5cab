"""The reference model of an object: all that estimation and tracking know of it, built once from a mesh.

Lengths in metres, in the object's own frame. Colours are CIELAB (L 0..100), float32.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from huepose.colorpair.types import SurfacePairs
from huepose.geometry.arrays import Float32, Float64, Int32, UInt8
from huepose.geometry.diameter import thickness
from huepose.geometry.mesh import Mesh
from huepose.support.errors import InputError, require

COLOR_SCALES_M = (0.0010, 0.0035)
"""Standard deviations of the two Gaussians over which texture is averaged, on the model and in an image."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Samples of the surface, in random order: any prefix is a sparser, even sample.

    points, normals (N, 3) float32; lab (2, N, 3) float32: texture averaged at COLOR_SCALES_M. directions
    (V, 3) float32: unit vectors from the object to cameras. From direction v the samples
    `visible[offsets[v]:offsets[v + 1]]` are visible (self-occlusion included), in increasing order.
    """

    points: Float32
    normals: Float32
    lab: Float32
    directions: Float32
    visible: Int32
    offsets: Int32

    @cached_property
    def bounds(self) -> Float32:
        """Least and greatest coordinates (2, 3). Shared by all users: do not write to it."""
        return np.stack([self.points.min(0), self.points.max(0)])

    @cached_property
    def centre(self) -> Float64:
        """Middle of the bounds (3,). Shared by all users: do not write to it."""
        return np.asarray(0.5 * (self.bounds[0] + self.bounds[1]), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Nearest surface sample of every cell: `nearest[i, j, k]` (int16) is an index into Surface.points for
    the cell centred at `origin + step * (i, j, k)`; the grid reaches 3 cm beyond the object."""

    origin: Float64
    step: float
    nearest: np.ndarray


@dataclass(frozen=True, eq=False)
class ViewTemplates:
    """Small images of the object at metric scale.

    directions (V, 3) float32 as in Surface; planes (V, R, 5, S, S) float16: L, a, b, depth relative to the
    median visible depth in metres, coverage 0..1 (the first four are 0 where coverage is 0); R rolls of
    2 pi / R about the optical axis. The window spans `span` diameters at the median visible depth, centred
    on the centroid of the visible pixels; origins (V, 3) float32: the object's origin relative to that
    centroid point at median depth, in camera axes at roll 0.
    """

    directions: Float32
    planes: np.ndarray
    origins: Float32
    span: float


@dataclass(frozen=True, eq=False)
class PairReference:
    """The colour pairs of a model, coarse ones first, then fine ones (`reference_pairs`, `fine_pairs`).

    points (N, 3), normals (N, 3) float32: ridge points lifted to the surface; tangents (N, 3): unit
    direction in the surface that crosses the edge from side 0 to side 1; colors (N, 2, 3): CIELAB of both
    sides; views (N,) int32: index of the view that each came from. parameters: "coarse_pairs", how many
    rows are coarse, and the two scales "coarse_pixels_per_m" and "fine_pixels_per_m".
    """

    points: Float32
    normals: Float32
    tangents: Float32
    colors: Float32
    views: Int32
    parameters: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PaperTables:
    """The tables that only the paper's method needs (section III-C), made from the coarse pairs on request.

    centers (K, 3): the semantic classes, as CIELAB prototypes of side colours; side_classes (N, 2) uint8:
    of the coarse pairs. cloud_points, cloud_normals (M, 3), cloud_classes (M,) uint8, cloud_weights (M,):
    the classified cloud. triangle_keys (T,) int64 sorted; triangles (T, 3) int32: indices into the cloud,
    in canonical class order. ppf_keys (Q,) int64 sorted; ppf (Q, 2) int32: indices into the cloud;
    ppf_alpha (Q,) float32 radians. parameters: "side_offset_m", distance of the classified points from
    their edge, and the bins of the two tables, "triangle_bin_m" and "ppf_bin_m".
    """

    centers: Float32
    side_classes: UInt8
    cloud_points: Float32
    cloud_normals: Float32
    cloud_classes: UInt8
    cloud_weights: Float32
    triangle_keys: np.ndarray
    triangles: Int32
    ppf_keys: np.ndarray
    ppf: Int32
    ppf_alpha: Float32
    parameters: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Features of the object that are found again in other images, the most reliable first.

    points, normals (N, 3) float32: on the surface; descriptors (N, D) uint8, in a common scale; source:
    name of what computes the descriptors (`propose.features`).
    """

    points: Float32
    normals: Float32
    descriptors: UInt8
    source: str


@dataclass(frozen=True, eq=False)
class ReferenceModel:
    """One object.

    mesh: for rendering and tracking (texture at most 1024 px); eval_points (P, 3) float32: at most 20,000
    vertices at a fixed stride, at which errors are measured; diameter_m: the largest distance of two
    points. symmetries (S, 4, 4): declared rotations of the *shape* (identity first; continuous ones
    sampled); near_symmetries (M, 4, 4): near-symmetric rotations found on the geometry, used only as
    hypotheses (identity first); equivalents (E, 4, 4): rotations after which shape *and texture* look the
    same (identity first). With each of these rotations, T_cam_obj @ rotation is another pose.
    frame_offset_m: translation that takes a point of the PoseCNN/YCB-Video frame to this one, or None.
    tables: what the methods `paper` and `colorpair` need in addition; None unless onboarding was asked for
    it. digest: of the model's file, under which derived data is kept (`support.kept`), or None.
    """

    name: str
    object_id: int | None
    mesh: Mesh
    eval_points: Float32
    diameter_m: float
    symmetries: Float64
    near_symmetries: Float64
    equivalents: Float64
    frame_offset_m: Float64 | None
    surface: Surface
    grid: DistanceGrid
    templates: ViewTemplates
    pairs: PairReference
    keypoints: Keypoints
    tables: PaperTables | None = None
    digest: str | None = None

    @cached_property
    def thickness_m(self) -> float:
        """The object's least thickness, metres."""
        return thickness(self.surface.points.astype(np.float64))

    def near_symmetric(self, poses: Float64) -> Float64:
        """Poses T_cam_obj (N, 4, 4) after each of the near-symmetric rotations except the identity, those
        of the first pose first: (N * (M - 1), 4, 4)."""
        rotated = np.einsum("nij,mjk->nmik", poses, self.near_symmetries[1:])
        return np.asarray(rotated.reshape(-1, 4, 4))


class ReferenceModels(dict[str, ReferenceModel]):
    """Models by name. Raises InputError if it is made of something else, and for an unknown name."""

    def __init__(self, models: Mapping[str, ReferenceModel]) -> None:
        require(models, Mapping, "models", "reference models by name", "Load them: load_models(dir).")
        super().__init__(models)

    def __missing__(self, name: str) -> ReferenceModel:
        raise InputError(
            f"object '{name}'",
            found="no reference model of that name",
            expected=f"one of {', '.join(sorted(self)) or 'no objects at all'}",
            fix="Onboard it with `huepose onboard`, or check the spelling.",
        )


def reference_pairs(reference: PairReference) -> SurfacePairs:
    """The model's coarse pairs, in the object's frame."""
    n = int(reference.parameters["coarse_pairs"])
    return SurfacePairs(
        reference.points[:n], reference.normals[:n], reference.tangents[:n], reference.colors[:n]
    )


def fine_pairs(reference: PairReference, count: int) -> SurfacePairs:
    """At most `count` of the model's fine pairs, evenly spread over them, in the object's frame."""
    first = int(reference.parameters["coarse_pairs"])
    step = max(1, -(-(len(reference.points) - first) // count))
    rows = slice(first, None, step)
    return SurfacePairs(
        reference.points[rows], reference.normals[rows], reference.tangents[rows], reference.colors[rows]
    )
