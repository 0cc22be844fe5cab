"""Is it this size? What is seen may be the same shape, larger or smaller, as one clamp is of another.

A pose of a model of the wrong size is a compromise: the depth would lie on the surface better if the object
were larger or smaller. How much is found with the pose, by a few steps of a point-to-plane fit of seven
unknowns; where the points fix no size, as on a single face, nothing is said.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.geometry.kernels import solve_symmetric
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.refine.point_to_plane import SurfaceArrays, surface_arrays
from huepose.support.jit import jit_dividing

STEPS = 3
LEAST_GATE_M, GATE = 0.008, 0.06
"""Points farther from the surface than this (the larger of metres and diameters) count nothing."""

DEPTH_SIGMA_M, STEREO_SIGMA_PER_M = 0.0015, 0.0035
"""Deviation of depth: so much, and so much times the square of the distance in metres, as stereo has it. Far
away depth says little of size, and what is left of its systematic errors must not."""

POINTS_PER_READING = 6.0
"""Neighbouring depth pixels err alike: so many of them count as one."""

BELIEVED = np.array([0.1, 0.1, 0.1, 0.02, 0.02, 0.02, 0.05])
"""How far pose (radians, metres) and size (natural logarithm) are believed to be off, before looking."""


def stretch(model: ReferenceModel, region: Region, T_cam_obj: Float) -> float:
    """By how much larger than the model the believed points would have the object at a pose (4, 4), as a
    natural logarithm; negative where it should be smaller."""
    R, t = np.asarray(T_cam_obj[:3, :3], np.float64), np.asarray(T_cam_obj[:3, 3], np.float64)
    points = np.ascontiguousarray((region.points_cam - t) @ R)
    gate = max(LEAST_GATE_M, GATE * model.diameter_m)
    sigma_m = DEPTH_SIGMA_M + STEREO_SIGMA_PER_M * region.median_depth_m**2
    surface = surface_arrays(model.surface, model.grid)._replace(centre=model.mesh.centre)
    information = 1.0 / (sigma_m**2 * POINTS_PER_READING)
    return -_growth(points, region.point_weights, -R.T @ t, surface, gate, 1.0 / BELIEVED**2, information)


@jit_dividing
def _growth(
    points: Float64,
    weights: Float64,
    camera: Float64,
    surface: SurfaceArrays,
    gate: float,
    prior: Float64,
    information: float,
) -> float:
    """Logarithm by which points (N, 3) in the object's frame, which are moved, should grow about the centre
    to lie on the surface that is seen from `camera`; Tukey's weights times those given. information: of a
    single distance, `prior` (7,) that of pose and size before looking."""
    samples, normals, nearest = surface.samples, surface.normals, surface.nearest
    origin, step, centre = surface.origin, surface.step, surface.centre
    A, b, x, found, slope = np.empty((7, 7)), np.empty(7), np.empty(7), np.zeros(7), np.empty(7)
    for _ in range(STEPS):
        A[:] = 0.0
        for i in range(7):
            A[i, i] = prior[i]
            b[i] = -prior[i] * found[i]
        for k in range(points.shape[0]):
            p0, p1, p2 = points[k, 0], points[k, 1], points[k, 2]
            f0, f1, f2 = (p0 - origin[0]) / step, (p1 - origin[1]) / step, (p2 - origin[2]) / step
            c0, c1, c2 = int(np.rint(f0)), int(np.rint(f1)), int(np.rint(f2))
            if c0 < 0 or c1 < 0 or c2 < 0:
                continue
            if c0 >= nearest.shape[0] or c1 >= nearest.shape[1] or c2 >= nearest.shape[2]:
                continue
            j = nearest[c0, c1, c2]
            s0, s1, s2 = float(samples[j, 0]), float(samples[j, 1]), float(samples[j, 2])
            n0, n1, n2 = float(normals[j, 0]), float(normals[j, 1]), float(normals[j, 2])
            g0, g1, g2 = p0 - s0, p1 - s1, p2 - s2
            share = (g0 * g0 + g1 * g1 + g2 * g2) / (gate * gate)
            facing = n0 * (camera[0] - s0) + n1 * (camera[1] - s1) + n2 * (camera[2] - s2)
            if share >= 1.0 or facing <= 0.0:
                continue
            w = weights[k] * (1.0 - share) ** 2 * information
            a0, a1, a2 = p0 - centre[0], p1 - centre[1], p2 - centre[2]
            slope[0], slope[1], slope[2] = a1 * n2 - a2 * n1, a2 * n0 - a0 * n2, a0 * n1 - a1 * n0
            slope[3], slope[4], slope[5] = n0, n1, n2
            slope[6] = a0 * n0 + a1 * n1 + a2 * n2
            distance = g0 * n0 + g1 * n1 + g2 * n2
            for i in range(7):
                weighted = w * slope[i]
                b[i] -= weighted * distance
                for c in range(i + 1):
                    A[i, c] += weighted * slope[c]
        if not solve_symmetric(A, b, x):
            break
        for i in range(7):
            found[i] += x[i]
        for k in range(points.shape[0]):
            a0, a1, a2 = points[k, 0] - centre[0], points[k, 1] - centre[1], points[k, 2] - centre[2]
            points[k, 0] += x[1] * a2 - x[2] * a1 + x[3] + x[6] * a0
            points[k, 1] += x[2] * a0 - x[0] * a2 + x[4] + x[6] * a1
            points[k, 2] += x[0] * a1 - x[1] * a0 + x[5] + x[6] * a2
    return float(found[6])
