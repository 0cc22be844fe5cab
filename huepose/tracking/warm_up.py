"""A warm-up: all that a tracker can do, on made-up frames, so that every kernel is compiled and loaded before
the first real one, and the contours and codes of all views are ready. Without it a first search or correction
waits for the compiler, and each new view for its contour."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.judge.terms import NOTHING
from huepose.rendering.render import render
from huepose.tracking.competition import Claim, losers
from huepose.tracking.config import TrackerConfig
from huepose.tracking.hypothesis import Anchor, Hypothesis
from huepose.tracking.step import advance
from huepose.tracking.subject import Subject
from huepose.tracking.types import Correction, Verdict
from huepose.tracking.usual import Usual

CAST = 2
"""Number of objects in the frames: one can occlude another."""

_CAMERA = Camera(240.0, 240.0, 159.5, 119.5, 320, 240)
_PERIOD_NS = 33_000_000
_FRAMES = 10


def warm_up(
    subjects: Mapping[str, Subject],
    config: TrackerConfig,
    step: Callable[[RgbdFrame], object],
    correct: Callable[[Correction], object],
) -> None:
    """Let a new tracker of these objects (subjects by their names) acquire late, follow, agree, correct a
    little and grossly, jump and lose, while two objects partly occlude each other. step, correct: of that
    tracker, which cannot be used afterwards."""
    for subject in subjects.values():
        subject.make_ready()
    cast = list(subjects.items())[:CAST]
    if not cast:
        return
    shown = [subject for _, subject in cast]
    frames = [_frame(shown, number) for number in range(_FRAMES)]
    for number, frame in enumerate(frames):
        step(frame)
        for place, (name, subject) in enumerate(cast):
            past = max(number - 3, 0)
            T_cam_obj = _pose(subject, place, past)
            if number in (3, 6, 8):
                # A correction near the tracked pose is moved to the newest frame, one far off is caught up.
                T_cam_obj = se3.perturb(T_cam_obj, np.full(6, {3: 0.0, 6: 0.002, 8: 0.03}[number]))
                verdict = Verdict.ACQUIRE if number == 3 else Verdict.CORRECT
                correct(_correction(name, past, T_cam_obj, verdict, number))
            elif number == 5:
                correct(_correction(name, past, T_cam_obj, Verdict.AGREE, number))
    # A step that tries every stage: no pose reaches the usual total.
    T_start = _pose(shown[0], 0, 0)
    before = Hypothesis(T_start, NOTHING, np.zeros((6, 6)), "still", velocity=np.zeros(6))
    for unseen_s in (0.0, 0.1):
        hard = Anchor((before,), frames[0], Usual(9.0, np.zeros(3)), unseen_s=unseen_s)
        advance(shown[0], hard, frames[1], config)
    losers([Claim(shown[0].surface, T_start, total) for total in (1.0, 2.0)], frames[0].depth, _CAMERA)


def _pose(subject: Subject, place: int, number: int) -> Float64:
    """The pose in frame `number`: slowly to the side, with a jump."""
    size_m = 2.0 * subject.surface.radius_m
    x = 0.002 * number + 0.3 * size_m * place + (0.04 if number >= 7 else 0.0)
    R = se3.rotation_exp(np.array([0.3, 0.02 * number, 0.1 * place]))
    return se3.make(R, np.array([x, 0.0, 3.0 * size_m + 0.1 * place]) - R @ subject.surface.arrays.centre)


def _frame(shown: list[Subject], number: int) -> RgbdFrame:
    """A frame with the objects before a wall; without them in the last frame."""
    wall_m = 1.0 + max(8.0 * subject.surface.radius_m for subject in shown)
    color = np.random.default_rng(number).integers(60, 90, (240, 320, 3), dtype=np.uint8)
    depth = np.full((240, 320), wall_m, np.float32)
    if number < _FRAMES - 1:
        scene = [(subject.mesh, _pose(subject, place, number)) for place, subject in enumerate(shown)]
        picture = render(scene, _CAMERA)
        seen = picture.depth > 0
        color[seen], depth[seen] = picture.color[seen], picture.depth[seen]
    return RgbdFrame(color, depth, _CAMERA, number, (number + 1) * _PERIOD_NS, 1)


def _correction(name: str, past: int, T_cam_obj: Float64, verdict: Verdict, seq: int) -> Correction:
    stamp_ns = (past + 1) * _PERIOD_NS
    return Correction(name, 0, 1, past, stamp_ns, T_cam_obj, 0.95, verdict, seq)
