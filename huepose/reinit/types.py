"""What the re-initialisation loop asks for, what comes back, and what it says about the objects it seeks.

Times are CLOCK_MONOTONIC nanoseconds. Poses are `T_cam_obj` (4, 4) in metres; twists and covariances have
the order tx ty tz rx ry rz along camera axes about the object's origin.
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
"""A velocity says nothing about what lies further ahead, or back."""


@dataclass(frozen=True)
class ObjectSlot:
    """An object to look for, and how many of it there may be.

    diameter_m: of its model; what counts as the same pose scales with it. equivalents: turns (4, 4) under
    which shape and texture look the same; poses that differ by one of them are the same. bounds_m (2, 3):
    least and greatest coordinates of its model; two instances do not lie in each other."""

    object: str
    max_instances: int = 1
    diameter_m: float = 0.15
    equivalents: tuple[Float64, ...] = field(default=(), compare=False)
    bounds_m: Float64 | None = field(default=None, compare=False)

    @staticmethod
    def of(model: ReferenceModel, max_instances: int = 1) -> ObjectSlot:
        """What is known of the object by its reference model; the rest of it is let go."""
        equivalents, bounds = tuple(model.equivalents.copy()), model.mesh.bounds.copy()
        return ObjectSlot(model.name, max_instances, model.diameter_m, equivalents, bounds)

    @property
    def middle_obj(self) -> Float64:
        """The middle (3,) of its bounds, which its origin may lie far from; the origin where they are not
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
    covariance (6, 6) or None, and the capture stamp that it belongs to."""

    T_cam_obj: Float64
    velocity: Float64 | None
    covariance: Float64 | None
    stamp_ns: int

    def predicted(self, stamp_ns: int, middle_obj: Float64) -> Float64:
        """The pose at another stamp if the velocity held, at most LONGEST_AHEAD_S away: the object's middle
        (3,) moves straight, and an origin far from it on an arc."""
        if self.velocity is None:
            return self.T_cam_obj
        seconds = float(np.clip((stamp_ns - self.stamp_ns) * 1e-9, -LONGEST_AHEAD_S, LONGEST_AHEAD_S))
        lever = self.lever(middle_obj)
        moved = se3.perturb(self.T_cam_obj, se3.carrying(lever) @ self.velocity * seconds)
        moved[:3, 3] += lever - moved[:3, :3] @ middle_obj
        return moved

    def covariance_at(self, stamp_ns: int, middle_obj: Float64) -> Float64 | None:
        """The covariance at another stamp, grown over the time in between, in which the object may turn about
        its middle (3,); None where there is none."""
        if self.covariance is None:
            return None
        return se3.grown(self.covariance, abs(stamp_ns - self.stamp_ns) * 1e-9, self.lever(middle_obj))

    def lever(self, middle_obj: Float64) -> Float64:
        """From the object's origin to its middle (3,), camera axes."""
        return np.asarray(self.T_cam_obj[:3, :3] @ middle_obj)


@dataclass(frozen=True, eq=False)
class RequestedObject:
    """One object of a request. With an instance the tracked one is looked at again, and has a prior; with
    None the object is looked for anywhere, up to `wanted` instances that are not yet tracked. known: the
    tracked one is TRACKING; of any other it is not sure that it is the object. others: instances of it that
    are TRACKING, where a new one is not."""

    object: str
    instance: int | None
    prior: Prior | None = None
    wanted: int = 1
    known: bool = False
    others: tuple[Prior, ...] = ()


@dataclass(frozen=True, eq=False)
class Request:
    """What perception shall look at next. `number` counts requests; an answer repeats it.

    epoch is that of the newest tracked frame, None before the first. The chain has until `deadline_ns`. seen:
    camera epoch and number of a frame about which all was answered, so that a newer one is waited for.
    waiting: what else is missing; where something new in the picture looks like it, it is looked for, too."""

    number: int
    epoch: int | None
    deadline_ns: int
    objects: tuple[RequestedObject, ...]
    seen: tuple[int, int] | None = None
    waiting: tuple[RequestedObject, ...] = ()


@dataclass(frozen=True, eq=False)
class PerceptionResult:
    """The answer of the chain: the frame that it was computed on, and one estimate per looked-at candidate.

    An estimate's `instance` is that of the RequestedObject, or -1 where the object was looked for anywhere:
    then the loop decides which instance it is. request is the number of the Request."""

    request: int
    epoch: int
    frame_id: int
    stamp_ns: int
    estimates: tuple[PoseEstimate, ...]


@dataclass(frozen=True)
class Searching:
    """An object of which `missing` instances are still looked for (state SEARCHING: never seen yet)."""

    object: str
    missing: int


@dataclass
class Counters:
    """What happened since the start, for health."""

    requests: int = 0
    answers: int = 0
    expired: int = 0
    """Requests whose deadline passed without an answer, though there was a frame to answer on."""
    held: int = 0
    """Requests whose deadline passed while no new frame came: nothing of perception is wrong."""
    late: int = 0
    """Answers to a request that had expired or was never made."""
    wrong_epoch: int = 0
    """Answers on frames of another epoch, or from before the camera's clock was set back."""
    agreed: int = 0
    corrected: int = 0
    acquired: int = 0
    rejected: int = 0
    unconfirmed: int = 0
    """Acquisitions held back until a second estimate agrees."""
    resent: int = 0
    given_up: int = 0
    """Corrections that were never acknowledged in time."""
