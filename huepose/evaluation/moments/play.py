"""A tracker and the re-initialisation loop play a film; perception answers late, nearly with the truth.

The loop asks at 5 Hz, as when live; an answer comes when the chain has had its time, and holds what a good
single-frame estimate would: the true pose with small errors, for objects of which enough is seen, and for a
tracked object the comparison of that pose with the tracked one. So what is measured is the tracker and the
loop. The first poses are the truth.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from huepose.estimation.types import PoseEstimate
from huepose.evaluation import metrics
from huepose.evaluation.moments.film import Film, Seen, noisy
from huepose.evaluation.states import Moment
from huepose.geometry.arrays import Float64
from huepose.model.types import ReferenceModel
from huepose.reinit.association import displacement_m
from huepose.reinit.loop import ReinitLoop
from huepose.reinit.types import ObjectSlot, PerceptionResult, Request
from huepose.tracking import Correction, TrackedPose, Tracker

CHAIN_S = 0.35
"""From a request to its answer: the deadline is 0.6 s."""

SHIFT_M, TURN_RAD = 0.002, 0.02
LEAST_VISIBLE = 0.3
"""An object of which less is seen is not found."""

SCORE, SCORE_PER_DIAMETER = 1.9, 2.5
"""Scores of the dense judge: of a right pose, and what is lost per diameter of displacement, up to 1.2."""


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
        return Moment(self.stamp_ns, self.visib_fract >= 0.3, self.visib_fract < 0.1, self.state, self.right)


@dataclass(eq=False)
class Played:
    """What came of a film: per object, frame by frame; CPU seconds of each step of the tracker."""

    told: list[list[Told]]
    cpu_s: list[float] = field(default_factory=list)


def play(
    film: Film,
    models: Mapping[str, ReferenceModel],
    tracker: Tracker,
    *,
    reinit: bool = True,
    seed: int = 0,
    chain_s: float = CHAIN_S,
    on_frame: Callable[[Seen, list[TrackedPose]], None] | None = None,
) -> Played:
    """Track a film from its true first poses. Without `reinit` the tracker is alone after that."""
    objects = film.script.objects
    slots = [
        ObjectSlot(name, objects.count(name), models[name].diameter_m, tuple(models[name].equivalents))
        for name in dict.fromkeys(objects)
    ]
    loop = ReinitLoop(objects=slots)
    rng = np.random.default_rng([seed, 50])
    due: list[tuple[int, PerceptionResult]] = []
    played = Played([[] for _ in objects])
    for seen in film:
        now_ns = seen.frame.stamp_ns
        if seen.frame.frame_id == 0:
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
        request = loop.tick(now_ns, poses) if reinit else None
        if request is not None:
            answer = _answer(request, seen, objects, models, slots, rng)
            due.append((now_ns + round(chain_s * 1e9), answer))
        for k, told in enumerate(_told(seen, objects, models, poses)):
            played.told[k].append(told)
        if on_frame is not None:
            on_frame(seen, poses)
    return played


def _first(name: str, instance: int, seen: Seen, k: int) -> Correction:
    first = Correction.first(name, seen.T_cam_obj[k], seen.frame)
    return Correction(
        first.object,
        instance,
        first.epoch,
        first.frame_id,
        first.stamp_ns,
        first.T_cam_obj,
        1.0,
        first.verdict,
        1,
    )


def _answer(
    request: Request,
    seen: Seen,
    objects: tuple[str, ...],
    models: Mapping[str, ReferenceModel],
    slots: list[ObjectSlot],
    rng: np.random.Generator,
) -> PerceptionResult:
    """What perception would say of a frame."""
    by_name = {slot.object: slot for slot in slots}
    found: list[PoseEstimate] = []
    taken: set[int] = set()
    for asked in request.objects:
        slot = by_name[asked.object]
        prior = None if asked.prior is None else asked.prior.predicted(seen.frame.stamp_ns)
        mine = [
            k
            for k, name in enumerate(objects)
            if name == asked.object and k not in taken and seen.visib_fract[k] >= LEAST_VISIBLE
        ]
        if prior is not None:
            mine = sorted(mine, key=lambda k: float(np.linalg.norm(seen.T_cam_obj[k][:3, 3] - prior[:3, 3])))[
                :1
            ]
        for k in mine:
            taken.add(k)
            T = noisy(seen.T_cam_obj[k], rng, SHIFT_M, TURN_RAD)
            prior_score = None
            if prior is not None:
                off = displacement_m(prior, seen.T_cam_obj[k], slot) / slot.diameter_m
                prior_score = SCORE - min(SCORE_PER_DIAMETER * max(off - 0.1, 0.0), 1.2)
            instance = -1 if asked.instance is None else asked.instance
            covariance = np.diag([SHIFT_M**2] * 3 + [TURN_RAD**2] * 3)
            found.append(
                PoseEstimate(
                    asked.object, instance, True, T, 0.95, "TRACKING", SCORE, 0.3, covariance, None, None,
                    prior_score, prior, (), 0.1,
                )
            )  # fmt: skip
    frame = seen.frame
    return PerceptionResult(request.number, frame.epoch, frame.frame_id, frame.stamp_ns, tuple(found))


def _told(
    seen: Seen, objects: tuple[str, ...], models: Mapping[str, ReferenceModel], poses: list[TrackedPose]
) -> list[Told]:
    """Published poses go to the true ones of their object by least total error: twins have no names."""
    errors = np.full((len(objects), max(len(poses), 1)), np.inf)
    for k, name in enumerate(objects):
        for j, pose in enumerate(poses):
            if pose.object == name and pose.T_cam_obj is not None:
                add = metrics.add(models[name].eval_points, pose.T_cam_obj, seen.T_cam_obj[k])
                errors[k, j] = add / models[name].diameter_m
    cost = np.minimum(errors, 10.0)
    for k, name in enumerate(objects):
        for j, pose in enumerate(poses):
            # Any track of the object, also one without a pose, before one of another object.
            cost[k, j] += 0.0 if pose.object == name else 100.0
    out: list[Told | None] = [None] * len(objects)
    for k, j in zip(*linear_sum_assignment(cost), strict=True):
        if j < len(poses) and poses[j].object == objects[k]:
            p = poses[j]
            share = float(errors[k, j])
            out[k] = Told(
                seen.frame.stamp_ns, float(seen.visib_fract[k]), p.state.value, p.quality, share,
                share * models[p.object].diameter_m, p, seen.T_cam_obj[k],
            )  # fmt: skip
    return [
        t
        if t is not None
        else Told(
            seen.frame.stamp_ns,
            float(seen.visib_fract[k]),
            None,
            0.0,
            np.inf,
            np.inf,
            None,
            seen.T_cam_obj[k],
        )
        for k, t in enumerate(out)
    ]
