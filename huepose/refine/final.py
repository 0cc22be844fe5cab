"""The final refinement: the winning pose is fitted to the depth of the pixels that show the object, then its
texture to the image's edges. Also: how exact the pose is, and whether the object has the model's size.

The search on the score leaves a pose a millimetre from the best fit of the surface, because texture pulls it.
Where depth fixes a direction, depth is more exact (`refine_on_depth`). Depth does not fix a slide of a face
along itself; edges of the texture do, to a fraction of a pixel (`refine_on_edges`). Two factors, edges and
depth samples, enter one system, from a wide gate to a narrow one. Without enough edges that match the model's
in position, direction and contrast, the pose stays as it is. The covariance follows from the fit to depth,
with what texture fixes and with errors of model and calibration (`covariance`).

If the model has the wrong size, its pose is a compromise: depth would fit the surface better if the object
were larger or smaller. By how much is found by a few steps of point to plane with size as the seventh unknown
(`scale_residual`). Where the points do not fix the size, as on a single face, the result is about 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from huepose.colorpair.extract import extract
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float32, Float64, median
from huepose.geometry.camera import FLOOR_M, POINTS_PER_READING, Camera, depth_noise_m
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.se3 import carrying
from huepose.judge.region import Region
from huepose.judge.silhouette import visible_mask
from huepose.judge.terms import totals
from huepose.model.types import PairReference, ReferenceModel, Surface, fine_pairs
from huepose.refine.point_to_plane import (
    SCRATCH_ROWS,
    Alignment,
    ScenePoints,
    SurfaceArrays,
    add_point_to_plane,
    align,
    surface_arrays,
)
from huepose.refine.projective import (
    DEPTH_GATE_M,
    DepthImage,
    DepthSamples,
    ImageEdges,
    ModelEdges,
    add_depth_samples,
    add_edges,
    depth_image,
    depth_samples,
    edge_cells,
    image_edges,
    model_edges,
)
from huepose.refine.solver import DAMPING, FEWEST_FOR_A_STEP, Body, advance, clear, normal_equations
from huepose.support.jit import jit
from huepose.support.kept import once_for_each

GATE_M, ITERATIONS, POINTS = 0.008, 8, 1000
"""Of the last fit to depth: largest distance of a reading that counts, metres; steps; most readings."""

WORTH = 0.1
"""A refined pose may lose this much of the score; one that loses more has slid off the texture."""


def final_refinement(
    model: ReferenceModel, frame: RgbdFrame, region: Region, T_cam_obj: Float64
) -> tuple[Float64, Alignment, Bool]:
    """The pose (4, 4) after `refine_on_depth` and then on the edges of its texture; the result of the fit to
    depth, and the mask (H, W) of the visible pixels."""
    fit, mask = refine_on_depth(model, frame, region, T_cam_obj)
    return refine_on_edges(model, frame, mask, fit.T_cam_obj), fit, mask


def refine_on_depth(
    model: ReferenceModel, frame: RgbdFrame, region: Region, T_cam_obj: Float64
) -> tuple[Alignment, Bool]:
    """A last robust fit of the pose (4, 4) to the depth of its own visible pixels, and their mask (H, W). If
    the fit loses more than WORTH of the score, the pose stays, with no iterations."""
    tolerance = 1.5 * region.tolerance_m
    mask = visible_mask(model, frame, T_cam_obj, tolerance)
    points = _points(frame, mask)
    fit = align(model.surface, model.grid, points, T_cam_obj, GATE_M, GATE_M, ITERATIONS)
    before, after = totals(model, region, np.stack([T_cam_obj, fit.T_cam_obj]))
    if after < before - WORTH:
        fit = align(model.surface, model.grid, points, T_cam_obj, GATE_M, GATE_M, 0)
    else:
        mask = visible_mask(model, frame, fit.T_cam_obj, tolerance)
    return fit, mask


def _points(frame: RgbdFrame, mask: Bool) -> Float64:
    """At most POINTS evenly strided points (N, 3), camera axes, of mask pixels that have depth."""
    flat = np.flatnonzero(mask)
    flat = flat[frame.depth.ravel()[flat] > 0]
    rows, columns = np.divmod(flat[:: max(1, -(-len(flat) // POINTS))], mask.shape[1])
    return frame.camera.backproject(np.stack([columns, rows], -1), frame.depth[rows, columns])


TEXTURE_SIGMA = np.array([0.004, 0.004, 0.004, 0.05, 0.05, 0.05])
"""Standard deviations to which texture fixes a pose where depth fixes nothing: metres and radians, camera
axes. Chosen."""

FLOOR_SIGMA = np.array([0.0005, 0.0005, 0.0010, 0.006, 0.006, 0.006])
"""Standard deviations of errors of model and calibration, which no number of points averages away; the same
units. Chosen."""


def covariance(alignment: Alignment, centre_obj: Float64) -> Float64:
    """Covariance (6, 6) of a pose from the point-to-plane fit at it; order tx ty tz rx ry rz, camera axes,
    about the origin. centre_obj (3,): the object's centre; TEXTURE_SIGMA and FLOOR_SIGMA are about it."""
    variance = (alignment.rms_m**2 + FLOOR_M**2) * POINTS_PER_READING
    to_origin = carrying(-alignment.T_cam_obj[:3, :3] @ centre_obj)
    information = to_origin.T @ alignment.information @ to_origin / variance + np.diag(1.0 / TEXTURE_SIGMA**2)
    return np.asarray(to_origin @ (np.linalg.inv(information) + np.diag(FLOOR_SIGMA**2)) @ to_origin.T)


PAIRS = 800
"""Largest number of colour pairs of the model; a view shows some of them."""


GATES_PX = np.array([5.0, 4.0, 3.0, 2.5, 2.0, 2.0, 1.5, 1.5])
"""Search distance across an edge for its partner, pixels, one step each."""

DEPTH_WEIGHT, EDGE_SAMPLES = 0.3, 300
"""With the edges: weight of a depth residual against one of an edge, both in metres, and surface samples."""

FEWEST_EDGES = 15
"""Fewest matched edges for a pose to be moved."""


class _Factors(NamedTuple):
    """Input of the two factors."""

    model: ModelEdges
    edges: ImageEdges
    image: DepthImage
    samples: DepthSamples


@dataclass(frozen=True, eq=False)
class EdgeAlignment:
    """T_cam_obj (4, 4); matched: edges in the last iteration, 0 when the pose was left alone."""

    T_cam_obj: Float64
    matched: int


def refine_on_edges(model: ReferenceModel, frame: RgbdFrame, mask: Bool, T_cam_obj: Float64) -> Float64:
    """The pose (4, 4) after its texture is fitted to the edges inside the mask (H, W)."""
    textured = _edges_of(model.pairs)
    depths = frame.depth[mask]
    depths = depths[depths > 0]
    if not len(textured.points) or not len(depths):
        return T_cam_obj
    scale = model.pairs.parameters["fine_pixels_per_m"] * median(depths) / frame.camera.fx
    edges = image_edges(extract(frame.color, mask, scale=min(scale, 1.0)))
    return align_edges(textured, model.surface, edges, frame.depth, frame.camera, T_cam_obj).T_cam_obj


def align_edges(
    model: ModelEdges,
    surface: Surface,
    edges: ImageEdges,
    depth: Float32,
    camera: Camera,
    T_cam_obj: Float,
) -> EdgeAlignment:
    """Move the object so that its texture lies on the image's edges and its surface on the depth.

    model: the edges of its texture; depth (h, w) metres, 0 = nothing, of the camera that saw the edges.
    The pose comes back unchanged where fewer than FEWEST_EDGES match.
    """
    start = np.array(T_cam_obj, dtype=np.float64)
    if not len(model.points):
        return EdgeAlignment(start, 0)
    T = start.copy()
    low, high = surface.bounds.astype(np.float64)
    factors = _Factors(
        model,
        edges,
        depth_image(depth, camera),
        depth_samples(surface, T, EDGE_SAMPLES, DEPTH_WEIGHT),
    )
    body = Body(0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))
    matched = _align(T, factors, body, GATES_PX)
    if matched < FEWEST_EDGES:
        return EdgeAlignment(start, 0)
    return EdgeAlignment(se3.orthonormalised(T), int(matched))


@jit
def _align(T: Float64, factors: _Factors, body: Body, gates_px: Float64) -> int:
    """Move the pose in place, one step per gate; returns the edges matched in the last step."""
    image = factors.image
    cells = edge_cells(factors.edges, image.depth.shape[0], image.depth.shape[1])
    equations = normal_equations(6)
    matched = 0
    for gate_px in gates_px:
        clear(equations)
        matched, weight = add_edges(T, factors.model, factors.edges, cells, image, body, gate_px, equations)
        if matched < FEWEST_FOR_A_STEP:
            break
        weight += add_depth_samples(T, factors.samples, image, body, DEPTH_GATE_M, equations)
        if advance(T, equations, body, DAMPING * weight) < 0.0:
            break
    return matched


@once_for_each
def _edges_of(reference: PairReference) -> ModelEdges:
    """The edges of a model's texture, made once for each model."""
    return model_edges(fine_pairs(reference, PAIRS))


SIZE_STEPS = 3
"""Gauss-Newton steps in which the size is found."""

SIZE_GATE = 0.06
"""Points farther from the surface than both this many diameters and GATE_M are ignored."""

SYSTEMATIC, COMMON_M = 1.3, 0.00085
"""Size follows from differences of distant parts, so errors that neighbouring readings share count: a factor
on the noise of depth, and metres for errors of a scanned model and a calibration."""

SIZE_PRIOR_SIGMA = np.array([0.02, 0.02, 0.02, 0.1, 0.1, 0.1, 0.05])
"""Prior standard deviations of pose (metres, radians) and size (natural logarithm)."""


def scale_residual(model: ReferenceModel, region: Region, T_cam_obj: Float) -> float:
    """By how much larger than the model the object is according to the believed points at a pose (4, 4), as a
    natural logarithm; negative if it is smaller."""
    gate = max(GATE_M, SIZE_GATE * model.diameter_m)
    weights = region.point_weights / (size_sigma_m(region.median_depth_m) ** 2 * POINTS_PER_READING)
    scene = ScenePoints(np.ascontiguousarray(region.points_cam), weights)
    body = Body(model.mesh.centre, 0.5 * model.diameter_m)
    units = np.array([1.0] * 3 + [body.radius] * 4)
    prior = 1.0 / (SIZE_PRIOR_SIGMA * units) ** 2
    T = np.array(T_cam_obj, np.float64)
    return _growth(T, scene, surface_arrays(model.surface, model.grid), body, gate, prior)


def size_sigma_m(distance_m: float) -> float:
    """Standard deviation of a distance between depth and surface when size is estimated, metres."""
    return SYSTEMATIC * depth_noise_m(distance_m) + COMMON_M


@jit
def _growth(
    T: Float64, scene: ScenePoints, surface: SurfaceArrays, body: Body, gate: float, prior: Float64
) -> float:
    """Logarithm by which the object should grow about its centre to lie on the points. T (4, 4) is moved;
    prior (7,): prior information of pose and size, in the unknowns' units."""
    equations, moved = normal_equations(7), np.zeros(7)
    scratch = np.empty((SCRATCH_ROWS, scene.points_cam.shape[0]))
    points, centre = np.empty_like(scene.points_cam), np.empty(3)
    for _ in range(SIZE_STEPS):
        # The points, scaled to an object of the model's size.
        size = np.exp(moved[6] / body.radius)
        for r in range(3):
            centre[r] = T[r, 3]
            for c in range(3):
                centre[r] += T[r, c] * body.centre[c]
        for k in range(points.shape[0]):
            for r in range(3):
                points[k, r] = centre[r] + (scene.points_cam[k, r] - centre[r]) / size
        clear(equations)
        add_point_to_plane(T, ScenePoints(points, scene.weights), surface, body, gate, scratch, equations)
        for i in range(7):
            equations.A[i, i] += prior[i]
            equations.b[i] -= prior[i] * moved[i]
        if advance(T, equations, body, 0.0) < 0.0:
            break
        for i in range(7):
            moved[i] += equations.step[i]
    return float(moved[6] / body.radius)
