"""The covariance that is published with a tracked pose.

Order tx ty tz rx ry rz, metres and radians, about the object's origin, camera axes. The refinement's
information counts residuals as if their errors were independent; those of neighbouring pixels are not, and a
sensor and a scanned model err alike everywhere, which no number of samples averages away.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.depth_noise import depth_noise_m

RESIDUALS_PER_READING = 12.0
"""This many residuals are worth one independent one."""

FLOOR_SIGMA = np.array([0.0003, 0.0003, 0.0005, 0.004, 0.004, 0.004])
BIAS_SHARE = 0.15
"""Of the depth sensor's noise: what its errors have in common over an object."""

WEAK_SIGMA = np.array([0.05, 0.05, 0.05, 0.5, 0.5, 0.5])
"""What is known even where nothing was measured: the object was tracked a moment ago."""


def covariance(information: Float64, distance_m: float) -> Float64:
    """Covariance (6, 6) of a refined pose at that distance."""
    weak = np.diag(1.0 / WEAK_SIGMA**2)
    independent = np.linalg.inv(information / RESIDUALS_PER_READING + weak)
    bias = BIAS_SHARE * depth_noise_m(distance_m)
    floor = FLOOR_SIGMA**2 + np.array([0.0, 0.0, bias**2, 0.0, 0.0, 0.0])
    return np.asarray(independent + np.diag(floor))


def spread_m(covariance: Float64, T_cam_obj: Float64, points_obj: Float32) -> float:
    """By how much the object's points (N, 3) lie off, RMS, if the pose errs as that covariance says."""
    points = points_obj.astype(np.float64) @ T_cam_obj[:3, :3].T
    shifts = np.zeros((len(points), 3, 6))
    shifts[:, :, :3] = np.eye(3)
    shifts[:, 0, 4], shifts[:, 0, 5] = points[:, 2], -points[:, 1]
    shifts[:, 1, 3], shifts[:, 1, 5] = -points[:, 2], points[:, 0]
    shifts[:, 2, 3], shifts[:, 2, 4] = points[:, 1], -points[:, 0]
    return float(np.sqrt(np.einsum("nij,jk,nik->", shifts, covariance, shifts) / len(points)))
