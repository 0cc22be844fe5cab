"""Is it this size? What is seen may be the same shape, larger or smaller, as one clamp is of another.

A pose of a model of the wrong size is a compromise: the depth would lie on the surface better if the object
were larger or smaller. How much is found with the pose, by a few steps of a point-to-plane fit of seven
unknowns; where the points fix no size, as on a single face, nothing is said.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.model.types import ReferenceModel
from huepose.verification.region import Region

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
    points = (region.points_cam - t) @ R
    camera = -R.T @ t
    sigma_m = DEPTH_SIGMA_M + STEREO_SIGMA_PER_M * region.median_depth_m**2
    found = np.zeros(7)
    for _ in range(STEPS):
        distance, normals, weights = _distances(model, points, camera, region.point_weights)
        arm = points - model.mesh.centre
        slopes = np.concatenate([np.cross(arm, normals), normals, (normals * arm).sum(1)[:, None]], axis=1)
        scale = weights[:, None] / (sigma_m**2 * POINTS_PER_READING)
        prior = 1.0 / BELIEVED**2
        step = np.linalg.solve(
            slopes.T @ (slopes * scale) + np.diag(prior), -(slopes * scale).T @ distance - prior * found
        )
        found += step
        points = points + np.cross(step[:3], arm) + step[3:6] + step[6] * arm
    return -float(found[6])


def _distances(
    model: ReferenceModel, points: Float64, camera: Float64, weights: Float64
) -> tuple[Float64, Float64, Float64]:
    """Of points (N, 3) in the object's frame: signed distance to the surface that the camera sees, its
    normals, and Tukey's weights times those given."""
    grid, surface = model.grid, model.surface
    last = np.array(grid.nearest.shape) - 1
    cell = np.rint((points - grid.origin) / grid.step).astype(np.int64)
    inside = ((cell >= 0) & (cell <= last)).all(1)
    index = grid.nearest[tuple(np.clip(cell, 0, last).T)].astype(np.int64)
    near, normals = surface.points[index].astype(np.float64), surface.normals[index].astype(np.float64)
    gap = points - near
    gate = max(LEAST_GATE_M, GATE * model.diameter_m)
    share = (gap**2).sum(1) / gate**2
    facing = (normals * (camera - near)).sum(1) > 0.0
    tukey = np.where(inside & facing & (share < 1.0), (1.0 - share) ** 2, 0.0)
    return (gap * normals).sum(1), normals, weights * tukey
