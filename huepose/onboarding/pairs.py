"""Build the colour pairs of a model from rendered views, offline (paper, section III-C).

Pairs are extracted from every view, lifted onto the surface and merged: a pair that is found in many views
becomes one row, weighted by the number of views. This is done at two scales. Every model has these pairs.
The tables of the paper's method are built from the coarse ones (`paper.tables`) on request.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.colorpair.extract import extract
from huepose.colorpair.lifting import lift
from huepose.colorpair.similarity import paired_similarity
from huepose.colorpair.types import SurfacePairs
from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Float32, Int32
from huepose.geometry.camera import Camera
from huepose.geometry.mesh import Mesh
from huepose.model.types import PairReference
from huepose.rendering.render import render
from huepose.support.jit import jit

DISTANCE = 4.0
"""Distance of the camera in the views, in object diameters."""


@dataclass(frozen=True, eq=False)
class MergedPairs:
    """Pairs of one scale in the object's frame, those seen by most views first; views (N,) int32: the view
    that each came from; seen (N,) int32: how many views saw it."""

    pairs: SurfacePairs
    views: Int32
    seen: Int32


@dataclass(frozen=True)
class Scale:
    """Resolution of views: pixels_per_mm, limited so that the diameter spans min_pixels to max_pixels."""

    pixels_per_mm: float
    min_pixels: float
    max_pixels: float

    def pixels(self, diameter_m: float) -> float:
        """Pixels that the diameter spans."""
        return float(np.clip(diameter_m * 1000 * self.pixels_per_mm, self.min_pixels, self.max_pixels))


COARSE, FINE = Scale(0.75, 110.0, 190.0), Scale(1.0, 130.0, 240.0)
"""Scales of the views: for hypotheses (large texture, few pairs) and for verification (small texture)."""

LEVEL = 1
"""Level of the icosphere of view directions."""

MIN_FACING = 0.35
"""Least cosine of the viewing angle at a pair."""

MAX_PAIRS = 8000
"""Most rows of a scale."""

MERGE = 0.012
"""Distance, in diameters, within which pairs of different views are merged."""

PAIRS_OF_A_VIEW = 4000
"""Most pairs that are extracted from a view."""


def coarse_and_fine(mesh: Mesh, diameter_m: float) -> tuple[MergedPairs, MergedPairs]:
    """The colour pairs of a mesh at both scales. An object without texture has few or none."""
    coarse, fine = (
        merged(*_all_pairs(mesh, scale, diameter_m), MERGE * diameter_m, MAX_PAIRS)
        for scale in (COARSE, FINE)
    )
    return coarse, fine


def pair_reference(coarse: MergedPairs, fine: MergedPairs, diameter_m: float) -> PairReference:
    """The pairs of both scales as a model keeps them, the coarse rows first."""
    every = SurfacePairs.joined([coarse.pairs, fine.pairs])
    return PairReference(
        points=every.points,
        normals=every.normals,
        tangents=every.tangents,
        colors=every.colors,
        views=np.concatenate([coarse.views, fine.views]),
        parameters={
            "coarse_pairs": float(len(coarse.pairs)),
            "coarse_pixels_per_m": COARSE.pixels(diameter_m) / diameter_m,
            "fine_pixels_per_m": FINE.pixels(diameter_m) / diameter_m,
        },
    )


def reference_camera(scale: Scale, diameter_m: float) -> Camera:
    """The camera of all views of a scale: it sees the whole object from DISTANCE diameters."""
    pixels = scale.pixels(diameter_m)
    side = int(np.ceil(pixels * 1.1)) + 8
    return Camera(pixels * DISTANCE, pixels * DISTANCE, (side - 1) / 2, (side - 1) / 2, side, side)


def _all_pairs(mesh: Mesh, scale: Scale, diameter_m: float) -> tuple[SurfacePairs, Int32]:
    """Pairs of all views of a scale in the object's frame, and the view that each came from."""
    camera, t = reference_camera(scale, diameter_m), np.array([0.0, 0.0, DISTANCE * diameter_m])
    centring = se3.make(np.eye(3), -mesh.centre)
    parts, owners = [], []
    for index, direction in enumerate(icosphere.directions(LEVEL)):
        T_cam_obj = se3.make(icosphere.look_at(direction), t) @ centring
        view = render([(mesh, T_cam_obj)], camera)
        seen = view.depth > 0
        pairs = extract(view.color, seen, max_pairs=PAIRS_OF_A_VIEW)
        lifted = lift(pairs, view.depth, seen, camera, radius_px=2, gate_m=0.02, min_facing=MIN_FACING)
        parts.append(lifted.transformed(se3.inverse(T_cam_obj)))
        owners.append(np.full(len(lifted), index, np.int32))
    return SurfacePairs.joined(parts), np.concatenate(owners)


def merged(pairs: SurfacePairs, owners: Int32, radius_m: float, limit: int) -> MergedPairs:
    """Merge pairs with nearly the same position, direction and colours: each group gets the position and
    direction of its pair with the most contrast, and the mean colours. At most `limit` pairs, those of the
    most views."""
    if not len(pairs):
        return MergedPairs(pairs, owners, np.zeros(0, np.int32))
    contrast = np.linalg.norm(pairs.colors[:, 1] - pairs.colors[:, 0], axis=1)
    order = np.argsort(-contrast, kind="stable")
    pairs, owners = pairs[order], owners[order]
    leader = _cluster_heads(pairs.points, pairs.normals, pairs.tangents, pairs.colors, radius_m)
    swapped = (pairs.tangents * pairs.tangents[leader]).sum(1) < 0
    colors = np.where(swapped[:, None, None], pairs.colors[:, ::-1], pairs.colors)
    alike = paired_similarity(colors, pairs.colors[leader])
    total = np.zeros((len(pairs), 2, 3))
    weight = np.zeros(len(pairs))
    np.add.at(total, leader, colors * alike[:, None, None])
    np.add.at(weight, leader, alike)
    seen = np.zeros(len(pairs), np.int32)
    distinct = np.unique(leader.astype(np.int64) * (int(owners.max()) + 1) + owners)
    np.add.at(seen, distinct // (int(owners.max()) + 1), 1)
    heads = np.flatnonzero(leader == np.arange(len(pairs)))
    heads = heads[np.argsort(-seen[heads], kind="stable")][:limit]
    mean = (total[heads] / weight[heads][:, None, None]).astype(np.float32)
    chosen = pairs[heads]
    pairs = SurfacePairs(chosen.points, chosen.normals, chosen.tangents, mean)
    return MergedPairs(pairs, owners[heads], seen[heads])


@jit
def _cluster_heads(
    points: Float32, normals: Float32, tangents: Float32, colors: Float32, radius: float
) -> Int32:
    """For each pair the index of the nearest earlier head of a group within `radius` whose normal, tangent
    and colours are similar, or its own index: then it is a head itself."""
    n = points.shape[0]
    low = np.empty(3)
    size = np.empty(3, np.int64)
    for a in range(3):
        low[a] = points[:, a].min()
        size[a] = int((points[:, a].max() - low[a]) / radius) + 1
    head = np.full((size[0], size[1], size[2]), -1, np.int32)
    follow = np.full(n, -1, np.int32)
    leader = np.arange(n).astype(np.int32)
    cell = np.empty(3, np.int64)
    for i in range(n):
        for a in range(3):
            cell[a] = int((points[i, a] - low[a]) / radius)
        best = radius * radius
        found = -1
        for x in range(max(cell[0] - 1, 0), min(cell[0] + 2, size[0])):
            for y in range(max(cell[1] - 1, 0), min(cell[1] + 2, size[1])):
                for z in range(max(cell[2] - 1, 0), min(cell[2] + 2, size[2])):
                    j = head[x, y, z]
                    while j >= 0:
                        d = 0.0
                        facing = 0.0
                        across = 0.0
                        for a in range(3):
                            d += (points[i, a] - points[j, a]) ** 2
                            facing += normals[i, a] * normals[j, a]
                            across += tangents[i, a] * tangents[j, a]
                        if d < best and facing > 0.7 and abs(across) > 0.8:
                            apart = 0.0
                            for side in range(2):
                                other = side if across > 0 else 1 - side
                                e = 0.0
                                for c in range(3):
                                    e += (colors[i, side, c] - colors[j, other, c]) ** 2
                                apart = max(apart, e)
                            if apart < 400.0:
                                best = d
                                found = j
                        j = follow[j]
        if found >= 0:
            leader[i] = found
        else:
            follow[i] = head[cell[0], cell[1], cell[2]]
            head[cell[0], cell[1], cell[2]] = i
    return leader
