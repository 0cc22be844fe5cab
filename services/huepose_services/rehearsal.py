"""A rehearsal for the tracker: all that it will do, on made-up frames, so that every kernel is compiled
before the first real one. Without it the first acquisition after an installation waits for the compiler."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from huepose.geometry import Camera, RgbdFrame, se3
from huepose.geometry.arrays import Float64
from huepose.model import ReferenceModel
from huepose.rendering.render import render
from huepose.tracking import Correction, Tracker, Verdict

_CAMERA = Camera(240.0, 240.0, 159.5, 119.5, 320, 240)
_PERIOD_NS = 33_000_000
_FRAMES = 10


def rehearse(models: Mapping[str, ReferenceModel]) -> None:
    """Acquire late, follow, agree, correct a little and grossly, jump, lose: with one or two objects that
    are partly before each other."""
    cast = list(models.values())[:2]
    tracker = Tracker({model.name: model for model in cast})
    for number in range(_FRAMES):
        frame = _frame(cast, number)
        tracker.step(frame)
        for place, model in enumerate(cast):
            past = max(number - 3, 0)
            T_cam_obj = _pose(model, place, past)
            if number in (3, 6, 8):
                # A pose that is nearly the tracked one is carried to now, one far off is caught up.
                T_cam_obj = se3.perturb(T_cam_obj, np.full(6, {3: 0.0, 6: 0.002, 8: 0.03}[number]))
                verdict = Verdict.ACQUIRE if number == 3 else Verdict.CORRECT
                tracker.correct(_correction(model, past, T_cam_obj, verdict, number))
            elif number == 5:
                tracker.correct(_correction(model, past, T_cam_obj, Verdict.AGREE, number))


def _pose(model: ReferenceModel, place: int, number: int) -> Float64:
    """Slowly to the side, with a jump, and gone behind the camera's back at the end."""
    depth_m = 3.0 * model.diameter_m + 0.1 * place
    x = 0.002 * number + 0.3 * model.diameter_m * place + (0.04 if number >= 7 else 0.0)
    R = se3.rotation_exp(np.array([0.3, 0.02 * number, 0.1 * place]))
    T_cam_obj = se3.make(R, np.array([x, 0.0, depth_m]))
    T_cam_obj[:3, 3] -= R @ model.mesh.centre
    return T_cam_obj


def _frame(cast: list[ReferenceModel], number: int) -> RgbdFrame:
    shown = cast if number < _FRAMES - 1 else []
    wall_m = 1.0 + max(4.0 * model.diameter_m for model in cast)
    color = np.random.default_rng(number).integers(60, 90, (240, 320, 3), dtype=np.uint8)
    depth = np.full((240, 320), wall_m, np.float32)
    if shown:
        picture = render([(m.mesh, _pose(m, place, number)) for place, m in enumerate(shown)], _CAMERA)
        seen = picture.depth > 0
        color[seen], depth[seen] = picture.color[seen], picture.depth[seen]
    return RgbdFrame(color, depth, _CAMERA, number, (number + 1) * _PERIOD_NS, 1)


def _correction(
    model: ReferenceModel, past: int, T_cam_obj: Float64, verdict: Verdict, seq: int
) -> Correction:
    stamp_ns = (past + 1) * _PERIOD_NS
    return Correction(model.name, 0, 1, past, stamp_ns, T_cam_obj, 0.95, verdict, seq)
