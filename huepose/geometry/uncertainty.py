"""Covariances of poses: order tx ty tz rx ry rz (metres, radians), a small translation and a small rotation
about the object's origin, both along camera axes."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64


def carrying(lever: Float) -> Float64:
    """The matrix (6, 6) that takes a small motion about one point of a body to the same motion about another,
    lever (3,) from the first to the second, metres, camera axes. So a covariance C about the first is
    `carrying(lever) @ C @ carrying(lever).T` about the second.

    >>> carrying([0.0, 0.0, 2.0]) @ [0, 0, 0, 0.1, 0, 0]
    array([ 0. , -0.2,  0. ,  0.1,  0. ,  0. ])
    """
    out = np.eye(6)
    out[:3, 3:] = -se3.hat(np.asarray(lever, np.float64))
    return out


def mahalanobis(T_a: Float, T_b: Float, covariance: Float) -> float:
    """Distance of two poses in standard deviations of `covariance` (6, 6), positive definite."""
    delta = se3.difference(np.asarray(T_a), np.asarray(T_b))
    squared = float(delta @ np.linalg.solve(np.asarray(covariance), delta))
    return float(np.sqrt(max(0.0, squared)))


def grown(covariance: Float, seconds: float, accel_m_s2: float = 4.0, accel_rad_s2: float = 20.0) -> Float64:
    """`covariance` (6, 6) after `seconds` without a measurement: white acceleration of the given RMS."""
    s = 0.5 * np.array([accel_m_s2] * 3 + [accel_rad_s2] * 3) * seconds**2
    return np.asarray(covariance, np.float64) + np.diag(s**2)
