"""A tracker and the re-initialisation loop play a film, as in a live pipeline.

The loop sends requests at 5 Hz; the answer comes after the latency of perception, and is about the frame of
the request.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from huepose.datasets.types import GONE, VISIBLE
from huepose.estimation import PoseEstimate
from huepose.evaluation import metrics
from huepose.evaluation.states import Moment
from huepose.geometry.arrays import Float64
from huepose.model import ReferenceModel
from huepose.reinit.loop import ReinitLoop
from huepose.reinit.types import ObjectSlot, PerceptionResult, Request
from huepose.tracking import Correction, TrackedPose, Tracker
from studies.stress.films import Seen

CHAIN_S, EACH_MORE_S = 0.35, 0.05
"""Time from a request to its answer (the deadline is 0.6 s), and more for each object beyond two."""


class Perception(Protocol):
    """Estimates poses at 5 Hz."""

    def answer(self, request: Request, seen: Seen) -> Sequence[PoseEstimate]:
        """Estimates of the requested objects in a frame."""
        ...


def play(
    frames: Sequence[Seen],
    model: ReferenceModel,
    tracker: Tracker,
    first: Float64,
    quality: float = 1.0,
    perception: Perception | None = None,
) -> list[Moment]:
    """Track a film of one object from a first pose (4, 4) with its quality; without `perception` the tracker
    is alone. Returns the published state for each frame, of the track nearest to the truth."""
    tracker.correct(Correction.first(model.name, first, frames[0].frame, quality))
    loop = ReinitLoop(objects=[ObjectSlot.of(model)])
    return [_moment(seen, model, poses) for seen, poses in followed(frames, tracker, loop, perception)]


def followed(
    frames: Iterable[Seen], tracker: Tracker, loop: ReinitLoop, perception: Perception | None
) -> Iterator[tuple[Seen, list[TrackedPose]]]:
    """The frames of a film, and the poses that are published for each."""
    due: list[tuple[int, PerceptionResult]] = []
    for seen in frames:
        frame, now_ns = seen.frame, seen.frame.stamp_ns
        for item in [d for d in due if d[0] <= now_ns]:
            due.remove(item)
            for correction in loop.answer(now_ns, item[1]):
                tracker.correct(correction)
        for correction in loop.repeats(now_ns):
            tracker.correct(correction)
        poses = tracker.step(frame)
        request = None if perception is None else loop.tick(now_ns, poses)
        if perception is not None and request is not None:
            found = tuple(perception.answer(request, seen))
            answer = PerceptionResult(request.number, frame.epoch, frame.frame_id, frame.stamp_ns, found)
            asked = {one.object for one in request.objects} | {estimate.object for estimate in found}
            takes_s = CHAIN_S + EACH_MORE_S * max(0, len(asked) - 2)
            due.append((now_ns + round(takes_s * 1e9), answer))
        yield seen, poses


def _moment(seen: Seen, model: ReferenceModel, poses: list[TrackedPose]) -> Moment:
    """The state of the track nearest to the truth, and whether its pose is right."""
    error, state = np.inf, None
    if poses:
        errors = [error_of(model, pose.T_cam_obj, seen.T_cam_obj) for pose in poses]
        k = int(np.argmin(errors))
        error, state = errors[k], poses[k].state
    share = seen.visib_fract
    right = error < metrics.RECALL_FRACTION
    return Moment(seen.frame.stamp_ns, share >= VISIBLE, share < GONE, state, right)


def error_of(
    model: ReferenceModel, T_cam_obj: Float64 | None, truth: Float64, rotations: Float64 | None = None
) -> float:
    """ADD in diameters to the nearest of the true poses with rotations (M, 4, 4) of the object, by default
    its equivalent rotations; inf without a pose."""
    if T_cam_obj is None:
        return np.inf
    rotations = model.equivalents if rotations is None else rotations
    return min(metrics.add(model.eval_points, T_cam_obj, truth @ r) for r in rotations) / model.diameter_m
