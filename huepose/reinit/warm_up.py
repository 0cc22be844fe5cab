"""Warm-up: one answer of each kind, so that everything is loaded and compiled before the first real one. On a
busy computer that reads libraries from disk this takes seconds."""

from __future__ import annotations

import numpy as np

from huepose.believe.state import State
from huepose.estimation.types import PoseEstimate
from huepose.geometry import se3
from huepose.reinit.loop import ReinitLoop
from huepose.reinit.types import ObjectSlot, PerceptionResult
from huepose.tracking.types import TrackedPose

_PERIOD_NS = 200_000_000


def warm_up() -> None:
    """Let a separate loop acquire an object, agree, correct and reject."""
    loop = ReinitLoop(objects=[ObjectSlot("warm_up")])
    start = se3.make(np.eye(3), np.array([0.0, 0.0, 1.0]))
    tracks: list[TrackedPose] = []
    for number, shift in enumerate((0.0, 0.0, 0.02, 0.06)):
        now_ns = number * _PERIOD_NS
        request = loop.tick(now_ns, tracks)
        if request is None:
            return
        T = se3.perturb(start, np.array([shift, 0.0, 0.0, 0.0, shift, 0.0]))
        result = PerceptionResult(request.number, 1, number, now_ns, (_estimate(T, number),))
        for correction in loop.answer(now_ns + 1, result):
            tracks = [_tracked(start, number, correction.seq)]


def _estimate(T_cam_obj: np.ndarray, number: int) -> PoseEstimate:
    return PoseEstimate(
        object="warm_up",
        instance=0 if number else -1,
        found=True,
        T_cam_obj=T_cam_obj,
        quality=0.99,
        state=State.TRACKING,
        score=2.0 if number < 3 else 1.0,
        margin=0.5,
        covariance=1e-6 * np.eye(6),
        prior_score=1.5,
        prior_T_cam_obj=T_cam_obj,
    )


def _tracked(T_cam_obj: np.ndarray, number: int, applied: int) -> TrackedPose:
    return TrackedPose(
        object="warm_up",
        instance=0,
        epoch=1,
        frame_id=number,
        stamp_ns=number * _PERIOD_NS,
        state=State.TRACKING,
        T_cam_obj=T_cam_obj,
        velocity=np.zeros(6),
        quality=0.9,
        covariance=1e-6 * np.eye(6),
        applied_correction_seq=applied,
    )
