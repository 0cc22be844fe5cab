"""Hard moments: the figures of steadiness on made-up poses, and two moments that are drawn and played."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from huepose.evaluation.moments import scripts
from huepose.evaluation.moments.challenge import challenge
from huepose.evaluation.moments.film import Film, draw
from huepose.evaluation.moments.perception import Oracle
from huepose.evaluation.moments.picture import COLOURS, bands, meaning
from huepose.evaluation.moments.play import Told, play
from huepose.evaluation.moments.scripts import MOMENTS, Script, carried
from huepose.evaluation.moments.steadiness import covered, foretold, lag_s, stillness
from huepose.evaluation.states import report
from huepose.geometry import se3
from huepose.tracking import State, TrackedPose, Tracker

SIGMA = np.array([0.001] * 3 + [0.01] * 3)


def told(k: int, truth: np.ndarray, T: np.ndarray, velocity: np.ndarray | None = None) -> Told:
    pose = TrackedPose("box", 0, 1, k, k * 33_333_333, State.TRACKING, T, velocity, 0.9, np.diag(SIGMA**2), 1)
    return Told(k * 33_333_333, 1.0, "TRACKING", 0.9, 0.01, 0.002, pose, truth)


def at(x: float) -> np.ndarray:
    return se3.make(np.eye(3), np.array([x, 0.0, 0.6]))


def test_stillness_of_known_noise() -> None:
    rng = np.random.default_rng(2)
    rows = [told(k, at(0.1), se3.perturb(at(0.1), rng.normal(0.0, SIGMA))) for k in range(2000)]
    figures = stillness(rows)
    assert figures.tremble_mm == pytest.approx(np.sqrt(3), rel=0.05)
    assert figures.tremble_deg == pytest.approx(np.degrees(0.01 * np.sqrt(3)), rel=0.05)
    assert figures.covered == pytest.approx(95.4, abs=1.0)
    shifted = [replace(r, truth=at(0.11)) for r in rows]
    assert stillness(shifted).tremble_mm == pytest.approx(figures.tremble_mm)
    assert stillness(shifted).error_mm > 10.0
    with pytest.raises(ValueError, match="no pose"):
        stillness([*rows[:3], replace(rows[3], pose=None)])


def test_lag_and_foresight_of_a_steady_motion() -> None:
    speed = 0.3
    truth = [at(speed * k * 0.033333333) for k in range(30)]
    late = [told(k, T, at(T[0, 3] - 0.02 * speed)) for k, T in enumerate(truth)]
    assert lag_s(late) == pytest.approx(0.02, rel=1e-3)
    velocity = np.array([speed, 0, 0, 0, 0, 0])
    steady = [told(k, T, T, velocity) for k, T in enumerate(truth)]
    assert np.abs(foretold(steady, 3)[0]).max() < 1e-6
    still = [told(k, T, T, np.zeros(6)) for k, T in enumerate(truth)]
    np.testing.assert_allclose(foretold(still, 3)[0], 1e3 * speed * 0.1, rtol=1e-6)
    assert covered(steady) == 100.0


def test_bands_say_what_became_of_each_frame() -> None:
    good = told(0, at(0.0), at(0.0))
    rows = [good, replace(good, error=0.3), replace(good, state="SUSPECT"), replace(good, pose=None)]
    assert [meaning(r) for r in rows] == ["TRACKING, right", "TRACKING, wrong", "SUSPECT, right", "no pose"]
    picture = bands([("a moment", rows)], "title")
    middle = 62 + 7
    seen = {tuple(int(c) for c in picture[middle, 250 + 95 + 190 * k]) for k in range(4)}
    assert seen == {COLOURS[meaning(r)] for r in rows}


def test_every_moment_is_staged() -> None:
    assert len(MOMENTS) == 12
    frozen, pause = MOMENTS["frozen"](), MOMENTS["pause"]()
    assert frozen.shown.count(60) == 20
    assert max(np.diff(pause.slots)) == 10, "nine frames are missing: 300 ms until the next"


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
    assert quality[right].min() > 0.9
    assert quality[~right].max() < 0.6


def test_spoilt_depth_is_what_was_asked_for() -> None:
    whole = draw(short(scripts.near(), 0, 2), 0)
    holes = scripts.holes()
    spoilt = draw(short(holes, 60, 62), 0)
    intact = draw(short(replace(holes, holes=scripts.NEVER), 60, 62), 0)
    lost = (spoilt.depth == 0).mean() - (intact.depth == 0).mean() * 0.4
    assert lost == pytest.approx(0.6, abs=0.03)
    assert whole.depth[whole.depth > 0].min() >= 0.45


def test_things_are_carried_at_a_human_pace() -> None:
    path = carried(90)
    steps = np.linalg.norm(np.diff(path[:, :3, 3], axis=0), axis=1) * 30
    turns = [se3.rotation_angle(a, b) * 30 for a, b in pairwise(path)]
    assert 0.03 < steps.mean() < 0.3
    assert 0.5 < np.mean(turns) < 2.5
