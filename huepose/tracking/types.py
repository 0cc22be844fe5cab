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
    """The one reason why a pose that fits the frame is not `TRACKING`."""

    TURN = "turn"
    """In another orientation the object would fit nearly as well."""
    IDENTITY = "identity"
    """It is not sure that the first pose, or the object, was the right one."""
    ANOTHER = "another"
    """It is more likely another object, or it was found after a loss by its appearance alone."""
    LOOSE = "loose"
    """Too little of it is visible to fix its pose."""
    FOUND = "found"
    """It has fitted for less than two frames at 30 Hz."""


class Verdict(str, Enum):
    """The decision of the re-initialisation loop about an estimate. A REJECT is sent to the tracker only if
    the estimate has the object at the same position in another orientation."""

    AGREE = "agree"
    CORRECT = "correct"
    ACQUIRE = "acquire"
    REJECT = "reject"


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """One instance in one frame. T_cam_obj (4, 4), covariance (6, 6) and velocity (6,) are None without a
    pose.

    Covariance: order tx ty tz rx ry rz, metres and radians, about the object's origin, camera axes; velocity
    in the same order per second. stamp_ns: capture time of the frame. applied_correction_seq: the last
    correction that was applied, or tried and not supported by the image.
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
    """What a first correction needs of an estimate (`PoseEstimate`)."""

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
    was made, ns, or another number that grows for each instance; mask (H, W) bool at that frame, which only
    the paper's tracker reads; reason, present: those of the estimate that it was made from. Raises InputError
    if T_cam_obj is no rigid transform (4, 4), or quality is not in 0..1."""

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
        if not 0.0 <= self.quality <= 1.0:
            what = f"quality of the correction of '{self.object}'"
            raise InputError(what, found=str(self.quality), expected="a probability, 0 to 1")

    @staticmethod
    def of(estimate: Estimated, frame: RgbdFrame) -> Correction:
        """The correction that starts a track from an estimate of a frame, with the quality of that estimate;
        for programs that run a tracker themselves. Raises InputError if the estimate has no pose."""
        T = estimate.T_cam_obj
        if T is None:
            raise _no_pose(estimate.object, None, np.zeros(0))
        first = Correction.first(estimate.object, T, frame, estimate.quality)
        return replace(first, instance=estimate.instance, reason=estimate.reason, present=estimate.present)

    @staticmethod
    def first(name: str, T_cam_obj: Float64, frame: RgbdFrame, quality: float) -> Correction:
        """The correction that starts the first instance of an object from its pose T_cam_obj (4, 4), metres,
        in a frame. quality: the probability that this pose is right, 0..1; 1 for a true pose. Raises
        InputError as Correction does."""
        return Correction(
            name, 0, frame.epoch, frame.frame_id, frame.stamp_ns, T_cam_obj, quality, Verdict.ACQUIRE, 1
        )


def _no_pose(name: str, given: object, T: Float64) -> InputError:
    """The error for a correction of that object with an invalid pose. given: the value; T: the same as an
    array, empty if it is not numbers."""
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
    """What the tracker did with a correction."""

    APPLIED = "applied"
    CATCHING_UP = "catching_up"
    REPEATED = "repeated"
    REFUSED_OLD = "refused_old"
    REFUSED_EPOCH = "refused_epoch"
