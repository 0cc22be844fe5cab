"""Hard moments: two short ones, drawn and played."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from huepose.evaluation.states import report
from huepose.reinit import Request, RequestedObject
from huepose.scenes.frame import labels
from huepose.tracking import Tracker, TrackerConfig
from studies.hard_moments import scripts
from studies.hard_moments.film import Film
from studies.hard_moments.perception import Oracle, OwnEstimates
from studies.hard_moments.play import play
from studies.hard_moments.scripts import FRAMES, Script
from studies.hard_moments.traps import AWAY_M, TRAPS, swapped
from tests.studies.challenge import challenge


def short(script: Script, first: int, last: int) -> Script:
    """Only some frames of a script, at half size."""
    stage = script.stage
    part = replace(
        stage,
        T_room_mesh=stage.T_room_mesh[:, first : last + 1],
        T_cam_room=stage.T_cam_room[first : last + 1],
        lights=stage.lights[first : last + 1],
        camera=stage.camera.scaled(0.5),
    )
    every = tuple(range(last - first))
    holes = script.holes[first : last + 1] if len(script.holes) else script.holes
    return replace(script, stage=part, shown=every, slots=every, holes=holes)


def test_a_covered_object_is_lost_and_comes_back(tea_box, tmp_path: Path) -> None:
    """The board comes at the fifth frame and is gone after the twelfth."""
    script = scripts.covered()
    path = script.stage.T_room_mesh.copy()
    path[1, 5:13] = path[1, 75]
    path[1, :5] = path[1, 13:] = path[1, 0]
    script = replace(script, objects=("tea_box",), stage=replace(script.stage, T_room_mesh=path))
    film = Film(short(script, 0, 40), tmp_path)
    models = {"tea_box": tea_box}
    played = play(film, models, Tracker(models), perception=Oracle(film.script, models))
    figures = report([t.moment() for t in played.told[0]])
    assert figures.false_tracking_frames == 0
    assert figures.declared_suspect_after_frames is not None
    assert figures.declared_suspect_after_frames <= 2
    assert figures.declared_lost_after_frames is not None
    assert figures.declared_lost_after_frames <= 5
    assert figures.reacquired_after_s is not None
    assert figures.reacquired_after_s <= 0.4 + 0.35 + 0.01
    quality, right = challenge(film, {"tea_box": tea_box}, every=16)
    assert 2 <= right.sum() < len(right) / 2, "the frame before and the frame after, from the truth"
    level = TrackerConfig().tracking_quality
    assert quality[right].min() > level + 0.2, "believed at once, with nothing known beforehand"
    assert quality[~right].max() < level


def visible(script, k: int) -> float:
    return float(labels(script.stage, k, script.stage.camera.scaled(0.25)).visib_fract[0])


def test_what_is_gone_stays_gone_and_what_is_swapped_lies_in_its_place() -> None:
    for name in ("swapped", "can_swapped", "taken", "beside"):
        script = TRAPS[name]()
        assert visible(script, FRAMES - 1) < 0.1, name
    script = swapped()
    before, other = script.stage.T_room_mesh[0, 74], script.stage.T_room_mesh[1, 75]
    assert np.linalg.norm(before[:3, 3] - other[:3, 3]) < 0.02
    assert script.stage.T_room_mesh[0, 75, 2, 3] == AWAY_M


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
