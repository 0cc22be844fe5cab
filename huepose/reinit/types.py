"""Requests of the re-initialisation loop, the answers to them, and what the loop reports about missing
objects.

Times are CLOCK_MONOTONIC nanoseconds. Poses are `T_cam_obj` (4, 4) in metres; twists and covariances have the
order tx ty tz rx ry rz along camera axes about the object's origin.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from huepose.estimation.types import PoseEstimate
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.model.types import ReferenceModel
from huepose.support.errors import InputError

LONGEST_AHEAD_S = 0.5
"""A velocity predicts no further ahead, or back, than this."""


@dataclass(frozen=True)
class ObjectSlot:
    """An object to look for, and how many instances of it there may be.

    diameter_m: of its model; the tolerance for equal poses is a share of it. equivalents: rotations (4, 4)
    under which shape and texture look the same; poses that differ by one of them are the same. bounds_m (2,
    3): least and greatest coordinates of its model; two instances do not overlap."""

    object: str
    max_instances: int = 1
    diameter_m: float = 0.15
    equivalents: tuple[Float64, ...] = field(default=(), compare=False)
    bounds_m: Float64 | None = field(default=None, compare=False)

    @staticmethod
    def of(model: ReferenceModel, max_instances: int = 1) -> ObjectSlot:
        """The slot of a reference model. It keeps nothing else of the model."""
        equivalents, bounds = tuple(model.equivalents.copy()), model.mesh.bounds.copy()
        return ObjectSlot(model.name, max_instances, model.diameter_m, equivalents, bounds)

    @property
    def middle_obj(self) -> Float64:
        """The middle (3,) of its bounds, which its origin may be far from; the origin if the bounds are not
        known."""
        return np.zeros(3) if self.bounds_m is None else np.asarray(self.bounds_m.mean(0))

    def middle_cam(self, T_cam_obj: Float64) -> Float64:
        """The same in camera axes."""
        return np.asarray(T_cam_obj[:3, :3] @ self.middle_obj + T_cam_obj[:3, 3])

    def __post_init__(self) -> None:
        if self.max_instances < 1:
            raise InputError(
                f"max_instances of object '{self.object}'",
                found=str(self.max_instances),
                expected="1 or more",
                fix="Leave the object out of the list instead.",
            )


@dataclass(frozen=True, eq=False)
class Prior:
    """A tracked pose as the tracker last published it: T_cam_obj (4, 4), velocity (6,) per second or None,
    covariance (6, 6) or None, and its capture timestamp."""

    T_cam_obj: Float64
    velocity: Float64 | None
    covariance: Float64 | None
    stamp_ns: int

    def predicted(self, stamp_ns: int, middle_obj: Float64) -> Float64:
        """The pose at another timestamp if the velocity stayed constant, at most LONGEST_AHEAD_S away: the
        object's middle (3,) moves straight, and an origin far from it on an arc."""
        if self.velocity is None:
            return self.T_cam_obj
        seconds = float(np.clip((stamp_ns - self.stamp_ns) * 1e-9, -LONGEST_AHEAD_S, LONGEST_AHEAD_S))
        about_middle = se3.carrying(self.lever(middle_obj)) @ self.velocity
        return se3.moved(self.T_cam_obj, middle_obj, about_middle * seconds)

    def covariance_at(self, stamp_ns: int, middle_obj: Float64) -> Float64 | None:
        """The covariance at another timestamp, grown over the time in between, in which the object may rotate
        about its middle (3,); None without one."""
        if self.covariance is None:
            return None
        return se3.grown(self.covariance, abs(stamp_ns - self.stamp_ns) * 1e-9, self.lever(middle_obj))

    def lever(self, middle_obj: Float64) -> Float64:
        """From the object's origin to its middle (3,), camera axes."""
        return np.asarray(self.T_cam_obj[:3, :3] @ middle_obj)


@dataclass(frozen=True, eq=False)
class RequestedObject:
    """One object of a request. With an instance, that tracked instance is estimated again, and has a prior.
    With None, the object is searched for anywhere, up to `wanted` instances that are not yet tracked. known:
    the tracked instance is TRACKING; else it may be another object. others: instances of the object that are
    TRACKING; a new one is not at their place."""

    object: str
    instance: int | None
    prior: Prior | None = None
    wanted: int = 1
    known: bool = False
    others: tuple[Prior, ...] = ()


@dataclass(frozen=True, eq=False)
class Request:
    """What perception shall look for next. `number` counts requests; an answer repeats it.

    epoch is that of the newest tracked frame, None before the first. Perception has until `deadline_ns`.
    seen: camera epoch and number of a frame that was answered in full, so that a newer one is waited for.
    waiting: other missing objects; they are looked for, too, where something new in the image looks like
    them."""

    number: int
    epoch: int | None
    deadline_ns: int
    objects: tuple[RequestedObject, ...]
    seen: tuple[int, int] | None = None
    waiting: tuple[RequestedObject, ...] = ()


@dataclass(frozen=True, eq=False)
class PerceptionResult:
    """The answer of perception: the frame that it was computed on, and one estimate for each candidate.

    An estimate's `instance` is that of the RequestedObject, or -1 if the object was searched for anywhere:
    then the loop decides which instance it is. request is the number of the Request."""

    request: int
    epoch: int
    frame_id: int
    stamp_ns: int
    estimates: tuple[PoseEstimate, ...]


@dataclass(frozen=True)
class Searching:
    """An object of which `missing` instances are still searched for (state SEARCHING: never seen yet)."""

    object: str
    missing: int


@dataclass
class Counters:
    """What happened since the start, for health messages."""

    requests: int = 0
    answers: int = 0
    expired: int = 0
    """Requests whose deadline passed without an answer, though there was a frame to answer on."""
    held: int = 0
    """Requests whose deadline passed while no new frame came: no fault of perception."""
    late: int = 0
    """Answers to a request that had expired or was never made."""
    wrong_epoch: int = 0
    """Answers for frames of another epoch, or from before the camera's clock was set back."""
    agreed: int = 0
    corrected: int = 0
    acquired: int = 0
    rejected: int = 0
    unconfirmed: int = 0
    """Acquisitions held back until a second estimate agrees."""
    resent: int = 0
    given_up: int = 0
    """Corrections that no pose acknowledged in time."""
