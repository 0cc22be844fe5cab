"""The paper's tracker with the interface of the tracking protocol: it takes frames and late poses, and gives
poses.

It has no states and no confidence: every tracked pose is published as `TRACKING` with quality 1. A late pose
replaces the one at its frame, and the motion increments since then move it to the newest frame, as in ROFT.
The paper says only that its tracker is run by ROFT's protocol.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from huepose.believe.state import State
from huepose.geometry.arrays import Bool
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.paper.tracking import PaperStep
from huepose.support.stages import stage
from huepose.tracking.history import PoseHistory
from huepose.tracking.types import Applied, Correction, TrackedPose, Verdict

HISTORY_NS = 2_000_000_000
"""Largest age of a late pose."""

Key = tuple[str, int]


@dataclass(eq=False)
class _Followed:
    """One tracked instance: its past poses, and its mask in the newest frame if one was given."""

    history: PoseHistory
    mask: Bool | None = None
    applied_seq: int = 0


class PaperTracker:
    """Tracks instances of known objects through the frames of one camera, as in the paper."""

    def __init__(self, models: Mapping[str, ReferenceModel], step: PaperStep | None = None) -> None:
        self._models = dict(models)
        self._step = step or PaperStep.of()
        self._followed: dict[Key, _Followed] = {}
        self._waiting: list[Correction] = []
        self._frames: deque[RgbdFrame] = deque()

    def correct(self, correction: Correction) -> Applied:
        """Apply a pose for a past frame, or for the next frame."""
        if not self._frames or correction.stamp_ns > self._frames[-1].stamp_ns:
            self._waiting.append(correction)
            return Applied.CATCHING_UP
        followed = self._followed.get(correction.key)
        since = [frame for frame in self._frames if frame.stamp_ns >= correction.stamp_ns]
        if followed is None or not _replayable(followed.history, correction.stamp_ns):
            if correction.verdict is not Verdict.ACQUIRE or since[0].stamp_ns != correction.stamp_ns:
                return Applied.REFUSED_OLD
            self._start(correction, since)
            return Applied.APPLIED
        if correction.verdict in (Verdict.ACQUIRE, Verdict.CORRECT):
            followed.history.replay(correction.stamp_ns, correction.T_cam_obj)
            followed.mask = self._carried(correction, followed.history, since)
        followed.applied_seq = max(followed.applied_seq, correction.seq)
        return Applied.APPLIED

    def step(self, frame: RgbdFrame) -> list[TrackedPose]:
        """Track all instances to a new frame."""
        with stage("follow"):
            for key, followed in self._followed.items():
                self._follow(key, followed, self._frames[-1], frame)
                followed.history.forget_before(frame.stamp_ns - HISTORY_NS)
        self._frames.append(frame)
        while self._frames[0].stamp_ns < frame.stamp_ns - HISTORY_NS:
            self._frames.popleft()
        due = [c for c in self._waiting if c.stamp_ns <= frame.stamp_ns]
        self._waiting = [c for c in self._waiting if c.stamp_ns > frame.stamp_ns]
        for correction in due:
            self._start(correction, [frame])
        return [self._published(key, f, frame) for key, f in sorted(self._followed.items())]

    def _follow(self, key: Key, followed: _Followed, before: RgbdFrame, after: RgbdFrame) -> None:
        newest, T_cam_obj = followed.history.newest, None
        if newest is not None and newest.T_cam_obj is not None:
            T_cam_obj = self._step(self._models[key[0]], newest.T_cam_obj, before, after, followed.mask)
        followed.history.append(after.frame_id, after.stamp_ns, T_cam_obj)
        followed.mask = None

    def _carried(
        self, correction: Correction, history: PoseHistory, since: Sequence[RgbdFrame]
    ) -> Bool | None:
        """The mask of a late result, propagated to the newest frame; None if that is not possible."""
        if correction.mask is None or since[0].stamp_ns != correction.stamp_ns:
            return None
        poses = [history.at(frame.stamp_ns) for frame in since[:-1]]
        known = [T for T in poses if T is not None]
        model = self._models[correction.object]
        return self._step.carried(model, correction.mask, known, since) if len(known) == len(poses) else None

    def _start(self, correction: Correction, frames: Sequence[RgbdFrame]) -> None:
        """Start or restart an instance at the first of these frames, and track it to the last."""
        history = PoseHistory(self._models[correction.object].surface.centre)
        followed = _Followed(history, correction.mask, correction.seq)
        followed.history.append(frames[0].frame_id, frames[0].stamp_ns, correction.T_cam_obj)
        for before, after in pairwise(frames):
            self._follow(correction.key, followed, before, after)
        self._followed[correction.key] = followed

    def _published(self, key: Key, followed: _Followed, frame: RgbdFrame) -> TrackedPose:
        newest = followed.history.newest
        T = None if newest is None else newest.T_cam_obj
        return TrackedPose(
            object=key[0],
            instance=key[1],
            epoch=frame.epoch,
            frame_id=frame.frame_id,
            stamp_ns=frame.stamp_ns,
            state=State.LOST if T is None else State.TRACKING,
            T_cam_obj=T,
            velocity=None,
            quality=0.0 if T is None else 1.0,
            covariance=None,
            applied_correction_seq=followed.applied_seq,
        )


def _replayable(history: PoseHistory, stamp_ns: int) -> bool:
    return history.at(stamp_ns) is not None and history.unbroken_since(stamp_ns)
