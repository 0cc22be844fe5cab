"""How an object moves: the velocity from its increments, the pose to expect next, and how far it can have
moved since it was last seen.

A velocity is a twist per second in the order tx ty tz rx ry rz, camera axes, about the object's centre: an
origin far from it moves on an arc when the object rotates. The published velocity is about the origin
(`about_origin`). As in ROFT (Piga et al. 2022) it comes from filtered increments, not from differences of
single poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64
from huepose.judge.open_region import PreparedSurface
from huepose.tracking.config import TrackerConfig

SMOOTHING_S = 0.03
"""Time constant of the velocity filter: about one frame, because hands accelerate within few."""

MAX_AHEAD_S = 0.3
"""A velocity predicts no further ahead than this."""


def increment_velocity(surface: PreparedSurface, T_from: Float, T_to: Float, seconds: float) -> Float64:
    """The constant velocity (6,) that moves one pose to the other in `seconds`."""
    moved = surface.centre_cam(T_to) - surface.centre_cam(T_from)
    turned = se3.rotation_log(T_to[:3, :3] @ T_from[:3, :3].T)
    return np.concatenate([moved, turned]) / seconds


def filtered(velocity: Float64 | None, measured: Float64, seconds: float) -> Float64:
    """The velocity after a new measurement over an interval; the first one is taken as it is."""
    if velocity is None or seconds > MAX_AHEAD_S:
        return measured
    gain = 1.0 - np.exp(-seconds / SMOOTHING_S)
    return np.asarray(velocity + gain * (measured - velocity))


def predicted(
    surface: PreparedSurface, T_cam_obj: Float64, velocity: Float64 | None, seconds: float
) -> Float64:
    """The pose after `seconds` at constant velocity; unchanged without a velocity, or if the last pose is too
    old."""
    if velocity is None or seconds > MAX_AHEAD_S:
        return T_cam_obj
    return se3.moved(T_cam_obj, surface.middle_obj, velocity * seconds)


def same_motion(
    surface: PreparedSurface, velocity: Float64 | None, T_from: Float64, T_to: Float64
) -> Float64 | None:
    """The velocity of the same motion about the centre of another pose."""
    return (
        None if velocity is None else _about(velocity, surface.centre_cam(T_to) - surface.centre_cam(T_from))
    )


def about_centre(surface: PreparedSurface, T_cam_obj: Float64, velocity: Float64) -> Float64:
    """The velocity about the object's centre of a motion with this velocity about its origin."""
    return _about(velocity, surface.centre_cam(T_cam_obj) - T_cam_obj[:3, 3])


def about_origin(surface: PreparedSurface, T_cam_obj: Float64, velocity: Float64 | None) -> Float64 | None:
    """The velocity of the same motion about the object's origin, as by `se3.perturb`."""
    return None if velocity is None else _about(velocity, T_cam_obj[:3, 3] - surface.centre_cam(T_cam_obj))


def _about(velocity: Float64, lever: Float64) -> Float64:
    return np.concatenate([velocity[:3] + se3.hat(velocity[3:]) @ lever, velocity[3:]])


SLACK_M, SLACK_RAD = 0.02, np.radians(10.0)
"""Possible error of the last pose itself."""

MAX_M, MAX_RAD = 0.35, np.pi
"""The search goes no farther from the expected pose, however long the object was not visible."""

TRUSTED_VELOCITY = 0.5
"""Factor of the reach if the velocity is known: what remains is the acceleration."""

REFINED_M = 0.012
"""How far refinement may move a pose out of the reach."""


@dataclass(frozen=True, eq=False)
class Reach:
    """A region of poses: within `distance_m` of the centre (3,) and within `angle_rad` of any of the
    rotations."""

    centre_cam: Float64
    rotations: tuple[Float64, ...]
    distance_m: float
    angle_rad: float

    def holds(self, centre_cam: Float64) -> bool:
        """Whether an object's centre (3,) lies within, with a tolerance."""
        return se3.length(centre_cam - self.centre_cam) < self.distance_m + REFINED_M

    def seen_from(self, T_new_old: Float64) -> Reach:
        """The same region in the axes of a camera that has moved; T_new_old (4, 4): from the old axes to the
        new ones."""
        rotations = tuple(T_new_old[:3, :3] @ R for R in self.rotations)
        return replace(self, centre_cam=se3.apply(T_new_old, self.centre_cam), rotations=rotations)


def most_turned(velocity: Float64 | None, seconds: float, config: TrackerConfig) -> float:
    """The largest rotation, radians, between an object and its prediction `seconds` after its last pose."""
    radians = float(min(SLACK_RAD + config.max_search_rad_s * seconds, MAX_RAD))
    return radians if velocity is None or seconds > MAX_AHEAD_S else TRUSTED_VELOCITY * radians


def reaches(
    surface: PreparedSurface,
    T_last: Float64,
    velocity: Float64 | None,
    expected: Float64,
    seconds: float,
    config: TrackerConfig,
) -> tuple[Reach, Reach]:
    """Where an object can be `seconds` after its last pose: if it moved on with its velocity, to the pose
    `expected`, and if it did not."""
    metres = min(SLACK_M + config.max_search_m_s * seconds, MAX_M)
    radians = most_turned(None, seconds, config)
    last, going_on = T_last[:3, :3], expected[:3, :3]
    middle = 0.5 * (surface.centre_cam(T_last) + surface.centre_cam(expected))
    rotations = (last,) if expected is T_last else (last, going_on)
    far = Reach(middle, rotations, metres, radians)
    if velocity is None or seconds > MAX_AHEAD_S:
        return far, far
    near = Reach(
        surface.centre_cam(expected), (going_on,), TRUSTED_VELOCITY * metres, TRUSTED_VELOCITY * radians
    )
    return near, far


JUMP, MOST_JUMP = 4.0, 4.0
"""Log-odds that a pose loses for each reach by which it is farther away than the fastest motion leads, and
the most that it loses."""


def jump_odds(
    surface: PreparedSurface,
    T_last: Float64,
    expected: Float64,
    T_found: Float64,
    gone_s: float,
    config: TrackerConfig,
) -> float:
    """Log-odds of the motion to a pose that was found, not followed; 0 or less. 0 within what the search
    covers in `gone_s` seconds from the last or the expected pose."""
    metres, radians = SLACK_M + config.max_search_m_s * gone_s, SLACK_RAD + config.max_search_rad_s * gone_s
    nearest = np.inf
    for T in (expected, T_last):
        shift = se3.length(surface.centre_cam(T_found) - surface.centre_cam(T))
        nearest = min(nearest, max(shift / metres, se3.rotation_angle(T, T_found) / radians))
        if nearest <= 1.0:
            return 0.0
    return -min(MOST_JUMP, JUMP * (nearest - 1.0))


def jump_since(
    surface: PreparedSurface,
    known: tuple[Float64, int],
    found: tuple[Float64, int],
    config: TrackerConfig,
) -> float:
    """Log-odds, 0 or less, of the unobserved motion from a known pose to one that was found, each with its
    timestamp in nanoseconds. A little more than the fastest usual motion costs little: -1 at one and a half
    times the reach, -4 at twice."""
    (T_known, known_ns), (T_found, found_ns) = known, found
    jump = jump_odds(surface, T_known, T_known, T_found, (found_ns - known_ns) * 1e-9, config)
    return -(jump**2) / JUMP
