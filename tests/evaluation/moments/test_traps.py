"""Scenes that tempt a tracker: they show what they say, and one is played."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from huepose.evaluation.moments.film import Film
from huepose.evaluation.moments.perception import Oracle, OwnEstimates
from huepose.evaluation.moments.play import play
from huepose.evaluation.moments.scripts import FRAMES
from huepose.evaluation.moments.traps import AWAY_M, TRAPS, swapped
from huepose.evaluation.states import report
from huepose.geometry import se3
from huepose.reinit import Request, RequestedObject
from huepose.scenes.frame import labels
from huepose.tracking import Tracker

from .test_moments import short


def visible(script, k: int) -> float:
    return float(labels(script.stage, k, script.stage.camera.scaled(0.25)).visib_fract[0])


def test_every_trap_begins_with_the_object_in_sight() -> None:
    for make in TRAPS.values():
        script = make()
        assert len(script.shown) == FRAMES
        assert visible(script, 0) > 0.9, script.name


def test_what_is_gone_stays_gone_and_what_is_swapped_lies_in_its_place() -> None:
    for name in ("swapped", "can_swapped", "taken", "beside"):
        script = TRAPS[name]()
        assert visible(script, FRAMES - 1) < 0.1, name
    script = swapped()
    before, other = script.stage.T_room_mesh[0, 74], script.stage.T_room_mesh[1, 75]
    assert np.linalg.norm(before[:3, 3] - other[:3, 3]) < 0.02
    assert script.stage.T_room_mesh[0, 75, 2, 3] == AWAY_M


def test_the_camera_swings_and_the_object_stands() -> None:
    views = TRAPS["swung"]().stage.T_cam_room
    degrees = np.degrees([se3.rotation_angle(a, b) for a, b in pairwise(views)])
    assert 2.5 < degrees.max() < 5.0, "75 to 150 degrees a second at 30 Hz"
    assert degrees[:40].max() == 0.0


def test_a_look_alike_is_never_taken_for_the_object(tea_box, tmp_path: Path) -> None:
    """Six frames of the box, five behind the board, then its look-alike."""
    script = swapped()
    stage = script.stage
    order = np.concatenate([np.full(6, 50), np.full(6, 74), np.full(22, 110)])
    stage = replace(
        stage,
        T_room_mesh=stage.T_room_mesh[:, order],
        T_cam_room=stage.T_cam_room[order],
        lights=tuple(stage.lights[k] for k in order),
    )
    script = short(replace(script, objects=("tea_box",), decoys=(("tea_box", 1),), stage=stage), 0, 33)
    film, models = Film(script, tmp_path), {"tea_box": tea_box}
    tracker = Tracker(models)
    seen = list(film)
    played = play(film, models, tracker, perception=Oracle(script, models))
    figures = report([t.moment() for t in played.told[0]])
    assert figures.tracking_frames == 6
    assert figures.false_tracking_frames == 0
    asked = Request(1, 1, 0, (RequestedObject("tea_box", None),))
    assert OwnEstimates(script, models).answer(asked, seen[8]) == [], "behind the board there is nothing"
