"""Is it this size? What is seen may be the same shape, larger or smaller, as one clamp is of another.

A pose of a model of the wrong size is a compromise: the depth would lie on the surface better if the object
were larger or smaller. How much is found with the pose, by a few steps of point to plane with size as the
seventh unknown; where the points fix no size, as on a single face, nothing is said.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.geometry.depth_noise import POINTS_PER_READING, depth_noise_m
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.refine.final import GATE_M
from huepose.refine.point_to_plane import (
    SCRATCH_ROWS,
    ScenePoints,
    SurfaceArrays,
    add_point_to_plane,
    surface_arrays,
)
from huepose.refine.solver import Body, advance, clear, normal_equations
from huepose.support.jit import jit

STEPS = 3
GATE = 0.06
"""Points farther from the surface than this many diameters, and than the last fit's gate, count nothing."""

SYSTEMATIC, COMMON_M = 1.3, 0.00085
"""Size is read off the difference of far parts, so it must bear errors that neighbouring readings share: a
factor on the noise of depth, and metres of a scanned model and a calibration."""

PRIOR_SIGMA = np.array([0.02, 0.02, 0.02, 0.1, 0.1, 0.1, 0.05])
"""How far pose (metres, radians) and size (natural logarithm) are believed to be off, before looking."""


def scale_residual(model: ReferenceModel, region: Region, T_cam_obj: Float) -> float:
    """By how much larger than the model the believed points would have the object at a pose (4, 4), as a
    natural logarithm; negative where it should be smaller."""
    gate = max(GATE_M, GATE * model.diameter_m)
    weights = region.point_weights / (size_sigma_m(region.median_depth_m) ** 2 * POINTS_PER_READING)
    scene = ScenePoints(np.ascontiguousarray(region.points_cam), weights)
    body = Body(model.mesh.centre, 0.5 * model.diameter_m)
    units = np.array([1.0] * 3 + [body.radius] * 4)
    prior = 1.0 / (PRIOR_SIGMA * units) ** 2
    T = np.array(T_cam_obj, np.float64)
    return _growth(T, scene, surface_arrays(model.surface, model.grid), body, gate, prior)


def size_sigma_m(distance_m: float) -> float:
    """Deviation of a distance between depth and surface as far as size is concerned, metres."""
    return SYSTEMATIC * depth_noise_m(distance_m) + COMMON_M


@jit
def _growth(
    T: Float64, scene: ScenePoints, surface: SurfaceArrays, body: Body, gate: float, prior: Float64
) -> float:
    """Logarithm by which the object should grow about its centre to lie on the points. T (4, 4) is moved;
    prior (7,): information of pose and size before looking, in the unknowns' units."""
    equations, moved = normal_equations(7), np.zeros(7)
    scratch = np.empty((SCRATCH_ROWS, scene.points_cam.shape[0]))
    points, centre = np.empty_like(scene.points_cam), np.empty(3)
    for _ in range(STEPS):
        # The points as they are to an object of the model's size.
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
