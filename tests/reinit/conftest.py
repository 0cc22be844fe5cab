"""Made-up poses, tracks, estimates and answers."""

from __future__ import annotations

import numpy as np

from huepose.believe.state import State
from huepose.estimation.types import PoseEstimate
from huepose.geometry import se3
from huepose.reinit import PerceptionResult, Request
from huepose.tracking.types import TrackedPose

MS = 1_000_000
EPOCH = 7


def pose(x: float = 0.0, turn_deg: float = 0.0) -> np.ndarray:
    return se3.make(se3.rotation_exp(np.array([0, 0, np.radians(turn_deg)])), np.array([x, 0.0, 0.6]))


def track(
    object_name: str = "mug",
    instance: int = 0,
    state: State = State.TRACKING,
    T: np.ndarray | None = None,
    stamp_ms: float = 0.0,
    applied: int = 0,
    epoch: int = EPOCH,
    velocity: np.ndarray | None = None,
    quality: float = 0.9,
) -> TrackedPose:
    T = None if state is State.LOST else (pose() if T is None else T)
    covariance = None if T is None else np.diag([1e-6] * 3 + [1e-4] * 3)
    frame = round(stamp_ms / 33.3)
    return TrackedPose(
        object_name, instance, epoch, frame, round(stamp_ms * MS), state, T, velocity, quality, covariance,
        applied
    )  # fmt: skip


def estimate(
    object_name: str = "mug",
    T: np.ndarray | None = None,
    instance: int = -1,
    quality: float = 0.95,
    score: float = 2.0,
    prior_score: float | None = None,
    found: bool = True,
    present: float | None = None,
) -> PoseEstimate:
    T = (pose() if T is None else T) if found else None
    more = {"score": score, "prior_score": prior_score, "present": present}
    return PoseEstimate(object_name, instance, found, T, quality, State.TRACKING, **more)


def result(
    request: Request | int, stamp_ms: float, *estimates: PoseEstimate, epoch: int = EPOCH
) -> PerceptionResult:
    number = request if isinstance(request, int) else request.number
    return PerceptionResult(number, epoch, round(stamp_ms / 33.3), round(stamp_ms * MS), estimates)


def asked(request: Request | None) -> list[tuple[str, int | None]]:
    assert request is not None
    return [(o.object, o.instance) for o in request.objects]


def uncertain(shift_m: float, turn_rad: float) -> np.ndarray:
    return np.diag([shift_m**2] * 3 + [turn_rad**2] * 3)
