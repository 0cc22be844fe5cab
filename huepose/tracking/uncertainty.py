"""The covariance that is published with a tracked pose.

Order tx ty tz rx ry rz, metres and radians, about the object's origin, camera axes. The refinement's
information counts residuals as if their errors were independent; those of neighbouring pixels are not, and a
sensor and a scanned model err alike everywhere, which no number of samples averages away.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.camera import depth_noise_m

RESIDUALS_PER_READING = 12.0
"""This many residuals are worth one independent one."""

FLOOR_SIGMA = np.array([0.0003, 0.0003, 0.0005, 0.004, 0.004, 0.004])
BIAS_SHARE = 0.15
"""Of the depth sensor's noise: what its errors have in common over an object."""

WEAK_SIGMA = np.array([0.05, 0.05, 0.05, 0.5, 0.5, 0.5])
"""What is known even where nothing was measured: the object was tracked a moment ago."""

_WEAK = np.diag(1.0 / WEAK_SIGMA**2)


def covariance(information: Float64, distance_m: float) -> Float64:
    """Covariance (6, 6) of a refined pose at that distance."""
    out = np.linalg.inv(information / RESIDUALS_PER_READING + _WEAK)
    bias = BIAS_SHARE * depth_noise_m(distance_m)
    out.flat[::7] += FLOOR_SIGMA**2 + np.array([0.0, 0.0, bias**2, 0.0, 0.0, 0.0])
    return np.asarray(out)


def spread_m(covariance: Float64, T_cam_obj: Float64, points_obj: Float32) -> float:
    """By how much the object's points (N, 3) lie off, RMS, if the pose errs as that covariance says."""
    # A point p moves by t + r x p: its mean square needs the mean and the second moments of the points only.
    points = points_obj.astype(np.float64) @ T_cam_obj[:3, :3].T
    mean, second = points.mean(axis=0), points.T @ points / len(points)
    moved, mixed, turned = covariance[:3, :3], covariance[:3, 3:], covariance[3:, 3:]
    curl = np.array([mixed[1, 2] - mixed[2, 1], mixed[2, 0] - mixed[0, 2], mixed[0, 1] - mixed[1, 0]])
    square = np.trace(moved) + 2.0 * mean @ curl + np.trace(turned) * np.trace(second)
    return float(np.sqrt(square - (turned * second).sum()))
