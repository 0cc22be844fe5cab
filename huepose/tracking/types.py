"""What the tracker publishes, and the corrections it takes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Protocol

import numpy as np

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.support.errors import InputError

Key = tuple[str, int]
"""An instance: the name of its object, and its number."""


class Doubt(str, Enum):
    """What alone keeps a pose that fits the frame from being `TRACKING`."""

    TURN = "turn"
    """Turned another way the object would fit nearly as well."""
    IDENTITY = "identity"
    """Whether it was the right pose, or the right object, to begin with."""
    ANOTHER = "another"
    """It is more likely another thing, or was found after a loss by its looks alone."""
    LOOSE = "loose"
    """Too little of it is seen to fix its pose."""
    FOUND = "found"
    """It fits, and did not in the frame before."""


class Verdict(str, Enum):
    """What the judge of the re-initialisation loop made of an estimate. REJECT is sent where the estimate has
    the object at its place, turned another way."""

    AGREE = "agree"
    CORRECT = "correct"
    ACQUIRE = "acquire"
    REJECT = "reject"


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """One object at one frame. T_cam_obj (4, 4), covariance (6, 6) and velocity (6,) are None without a pose.

    Covariance: order tx ty tz rx ry rz, metres and radians, about the object's origin, camera axes; velocity
    in the same order per second. stamp_ns is the frame's capture time. applied_correction_seq: the last
    correction that was taken, or tried and not borne out by the image.
    """

    object: str
    instance: int
    epoch: int
    frame_id: int
    stamp_ns: int
    state: State
    T_cam_obj: Float64 | None
    velocity: Float64 | None
    quality: float
    covariance: Float64 | None
    applied_correction_seq: int

    @property
    def key(self) -> Key:
        """Which instance."""
        return self.object, self.instance


class Estimated(Protocol):
    """What starts a track of an estimate (`PoseEstimate`)."""

    @property
    def object(self) -> str: ...
    @property
    def instance(self) -> int: ...
    @property
    def T_cam_obj(self) -> Float64 | None: ...
    @property
    def quality(self) -> float: ...
    @property
    def reason(self) -> str: ...
    @property
    def present(self) -> float | None: ...


@dataclass(frozen=True, eq=False)
class Correction:
    """A verdict on one instance at one (past) frame, named by epoch, frame_id and capture time stamp_ns
    (CLOCK_MONOTONIC). T_cam_obj (4, 4): object to camera, metres; quality in 0..1; seq: the time at which it
    was made, ns, or another number that grows for each instance; mask (H, W) bool at that frame, which the
    paper's tracker alone reads; reason and present: of the estimate behind it.
    Raises InputError where T_cam_obj is no rigid transform (4, 4)."""

    object: str
    instance: int
    epoch: int
    frame_id: int
    stamp_ns: int
    T_cam_obj: Float64
    quality: float
    verdict: Verdict
    seq: int
    mask: Bool | None = None
    reason: str = ""
    present: float | None = None

    @property
    def key(self) -> Key:
        """Which instance."""
        return self.object, self.instance

    def __post_init__(self) -> None:
        try:
            T = np.asarray(self.T_cam_obj, np.float64)
        except (TypeError, ValueError):
            T = np.zeros(0)
        if not se3.is_rigid(T, se3.ROUNDED):
            raise _no_pose(self.object, self.T_cam_obj, T)
        object.__setattr__(self, "T_cam_obj", T)

    @staticmethod
    def of(estimate: Estimated, frame: RgbdFrame) -> Correction:
        """What starts the instance of an estimate of a frame, as sure as the estimate is, for those who run a
        tracker themselves. Raises InputError where it has no pose."""
        T = estimate.T_cam_obj
        if T is None:
            raise _no_pose(estimate.object, None, np.zeros(0))
        first = Correction.first(estimate.object, T, frame, estimate.quality)
        return replace(first, instance=estimate.instance, reason=estimate.reason, present=estimate.present)

    @staticmethod
    def first(name: str, T_cam_obj: Float64, frame: RgbdFrame, quality: float) -> Correction:
        """What starts the first instance of an object, with T_cam_obj (4, 4) in metres at a frame. quality:
        how probably that pose is right, 0..1; a true one has 1. Raises InputError where T_cam_obj is no rigid
        transform."""
        return Correction(
            name, 0, frame.epoch, frame.frame_id, frame.stamp_ns, T_cam_obj, quality, Verdict.ACQUIRE, 1
        )


def _no_pose(name: str, given: object, T: Float64) -> InputError:
    """What a correction of that object was given as its pose; T: as far as that is numbers."""
    fix = "Give an estimate to `Correction.of`."
    if given is None:
        found, fix = "None", "Ask `pose.found` first: an estimate without a pose has None."
    elif T.shape != (4, 4):
        found = f"a {type(given).__name__} of shape {T.shape}" if T.size else f"a {type(given).__name__}"
    elif not np.isfinite(T).all():
        found = "numbers that are not finite"
    else:
        found = "a matrix that is no rotation and translation: " + " ".join(f"{x:.4g}" for x in T[0]) + " ..."
    return InputError(
        f"T_cam_obj of the correction of '{name}'", found=found, expected="a rigid transform (4, 4)", fix=fix
    )


class Applied(str, Enum):
    """What became of a correction."""

    APPLIED = "applied"
    CATCHING_UP = "catching_up"
    REPEATED = "repeated"
    REFUSED_OLD = "refused_old"
    REFUSED_EPOCH = "refused_epoch"
