"""How an object moves: the velocity from its increments, and where it should be next.

A velocity is a twist per second in the order tx ty tz rx ry rz, camera axes, about the object's origin: the
convention of `se3.perturb`. As in ROFT (Piga et al. 2022) it comes from filtered increments, not from
differences of single poses.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64

SMOOTHING_S = 0.03
"""Time constant of the velocity's filter: about one frame, because hands accelerate within few."""

MAX_AHEAD_S = 0.3
"""A velocity says nothing about what lies further ahead."""


def increment_velocity(T_from: Float, T_to: Float, seconds: float) -> Float64:
    """The constant velocity (6,) that moves one pose to the other in that time."""
    return np.asarray(se3.difference(T_from, T_to) / seconds)


def filtered(velocity: Float64 | None, measured: Float64, seconds: float) -> Float64:
    """The velocity after a new measurement over an interval; the first one is taken as it is."""
    if velocity is None or seconds > MAX_AHEAD_S:
        return measured
    gain = 1.0 - np.exp(-seconds / SMOOTHING_S)
    return np.asarray(velocity + gain * (measured - velocity))


def predicted(T_cam_obj: Float64, velocity: Float64 | None, seconds: float) -> Float64:
    """The pose after an interval at constant velocity; unchanged without one, or when it is too long ago."""
    if velocity is None or seconds > MAX_AHEAD_S:
        return T_cam_obj
    return se3.perturb(T_cam_obj, velocity * seconds)
