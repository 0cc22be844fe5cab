"""A tracker and the re-initialisation loop play a film, as when live.

The loop asks at 5 Hz; an answer comes when the chain has had its time, and is about the frame that was asked
for.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from huepose.datasets.types import GONE, VISIBLE
from huepose.evaluation import metrics
from huepose.evaluation.states import Moment
from huepose.geometry.arrays import Float64
from huepose.model.types import ReferenceModel
from huepose.reinit.loop import ReinitLoop
from huepose.reinit.types import PerceptionResult
from huepose.tracking import Correction, TrackedPose, Tracker
from studies.hard_moments.film import Seen, Shown
from studies.hard_moments.perception import Perception, slots_of

CHAIN_S = 0.35
"""From a request to its answer: the deadline is 0.6 s."""


@dataclass(frozen=True, eq=False)
class Told:
    """One object of one frame as published: state, quality, ADD as a share of the diameter and in metres (inf
    without a pose), the pose and the truth."""

    stamp_ns: int
    visib_fract: float
    state: str | None
    quality: float
    error: float
    add_m: float
    pose: TrackedPose | None
    truth: Float64

    @property
    def right(self) -> bool:
        """Within a tenth of the diameter."""
        return self.error < metrics.RECALL_FRACTION

    def moment(self) -> Moment:
        """For the report of states."""
        visible, gone = self.visib_fract >= VISIBLE, self.visib_fract < GONE
        return Moment(self.stamp_ns, visible, gone, self.state, self.right)


@dataclass(eq=False)
class Played:
    """What came of a film: per object, frame by frame; CPU seconds of each step of the tracker."""

    told: list[list[Told]]
    cpu_s: list[float] = field(default_factory=list)


def play(
    film: Shown,
    models: Mapping[str, ReferenceModel],
    tracker: Tracker,
    *,
    perception: Perception | None = None,
    chain_s: float = CHAIN_S,
    first: tuple[Float64, float] | None = None,
    on_frame: Callable[[Seen, list[TrackedPose]], None] | None = None,
) -> Played:
    """Track a film. Without `perception` the tracker is alone after the true first poses, or after the pose
    and the quality `first`, of a film of one object."""
    objects = film.objects
    loop = ReinitLoop(objects=slots_of(objects, models))
    due: list[tuple[int, PerceptionResult]] = []
    played = Played([[] for _ in objects])
    for number, seen in enumerate(film):
        now_ns = seen.frame.stamp_ns
        if number == 0 and first is not None:
            tracker.correct(Correction.first(objects[0], first[0], seen.frame, first[1]))
        elif number == 0 and (perception is None or perception.starts_known):
            for k, name in enumerate(objects):
                tracker.correct(_first(name, objects[:k].count(name), seen, k))
        for item in [d for d in due if d[0] <= now_ns]:
            due.remove(item)
            for correction in loop.answer(now_ns, item[1]):
                tracker.correct(correction)
        for correction in loop.repeats(now_ns):
            tracker.correct(correction)
        begin = time.process_time()
        poses = tracker.step(seen.frame)
        played.cpu_s.append(time.process_time() - begin)
        request = None if perception is None else loop.tick(now_ns, poses)
        if perception is not None and request is not None:
            found, frame = perception.answer(request, seen), seen.frame
            answer = PerceptionResult(
                request.number, frame.epoch, frame.frame_id, frame.stamp_ns, tuple(found)
            )
            due.append((now_ns + round(chain_s * 1e9), answer))
        for k, told in enumerate(_told(seen, objects, models, poses)):
            played.told[k].append(told)
        if on_frame is not None:
            on_frame(seen, poses)
    return played


def _first(name: str, instance: int, seen: Seen, k: int) -> Correction:
    return replace(Correction.first(name, seen.T_cam_obj[k], seen.frame), instance=instance)


def _told(
    seen: Seen, objects: tuple[str, ...], models: Mapping[str, ReferenceModel], poses: list[TrackedPose]
) -> list[Told]:
    """Published poses go to the true ones of their object by least total error: twins have no names."""
    errors = np.full((len(objects), max(len(poses), 1)), np.inf)
    for k, name in enumerate(objects):
        for j, pose in enumerate(poses):
            if pose.object == name and pose.T_cam_obj is not None:
                add = min(
                    metrics.add(models[name].eval_points, pose.T_cam_obj, seen.T_cam_obj[k] @ turn)
                    for turn in models[name].equivalents
                )
                errors[k, j] = add / models[name].diameter_m
    cost = np.minimum(errors, 10.0)
    for k, name in enumerate(objects):
        for j, pose in enumerate(poses):
            # Any track of the object, also one without a pose, before one of another object.
            cost[k, j] += 0.0 if pose.object == name else 100.0
    stamp_ns, shares = seen.frame.stamp_ns, seen.visib_fract.tolist()
    out = [
        Told(stamp_ns, share, None, 0.0, np.inf, np.inf, None, truth)
        for share, truth in zip(shares, seen.T_cam_obj, strict=True)
    ]
    for k, j in zip(*linear_sum_assignment(cost), strict=True):
        if j < len(poses) and poses[j].object == objects[k]:
            p = poses[j]
            error = float(errors[k, j])
            add_m = error * models[p.object].diameter_m
            out[k] = Told(stamp_ns, shares[k], p.state.value, p.quality, error, add_m, p, seen.T_cam_obj[k])
    return out
