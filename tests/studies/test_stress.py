"""The frames and starts that a stressed tracker gets, and the figures of a run."""

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame, se3
from huepose.model import ReferenceModel
from studies.stress import __main__ as stress
from studies.stress.causes import JUMP_AT, JUMP_FRAMES, loaded_schedule, runs
from studies.stress.films import AWAY_AT, Film, Seen, _leaving
from studies.stress.objects import builtin_meshes, look_alike
from studies.stress.playing import Job, missing
from studies.stress.report import figures

FRAME_NS = round(1e9 / 30)


@pytest.fixture
def film() -> Film:
    """An object that moves 1 cm to the right in every frame, in front of a wall at 1 m."""
    camera = Camera(100.0, 100.0, 31.5, 23.5, 64, 48)
    color, depth = np.zeros((48, 64, 3), np.uint8), np.full((48, 64), 1.0, np.float32)
    frames = []
    for k in range(60):
        T = se3.make(np.eye(3), np.array([0.01 * k, 0.0, 0.6]))
        frame = RgbdFrame(color, depth, camera, frame_id=k, stamp_ns=k * FRAME_NS)
        frames.append(Seen(frame, T, 1.0))
    return Film("film", "carried", "box", tuple(frames), np.zeros((0, 4, 4)))


def test_steps_keep_timestamps_and_a_jump_takes_one_frame(film: Film, tea_box: ReferenceModel) -> None:
    by_cause = {run.cause: run for run in runs(film, tea_box, 0)}
    stamps = [s.frame.stamp_ns for s in by_cause["step 10"].frames]
    assert set(np.diff(stamps)) == {10 * FRAME_NS}
    jump = by_cause["jump"].frames
    moved = jump[JUMP_AT].T_cam_obj[0, 3] - jump[JUMP_AT - 1].T_cam_obj[0, 3]
    assert moved == pytest.approx(0.01 * (JUMP_FRAMES + 1))
    assert jump[JUMP_AT].frame.stamp_ns - jump[JUMP_AT - 1].frame.stamp_ns == pytest.approx(FRAME_NS, abs=2)


def test_wrong_starts_are_wrong_and_have_high_quality(film: Film, tea_box: ReferenceModel) -> None:
    by_cause = {run.cause: run for run in runs(film, tea_box, 0)}
    for cause in ("shifted", "turned", "elsewhere", "in the table"):
        run = by_cause[cause]
        off = run.first @ np.linalg.inv(run.frames[0].T_cam_obj)
        apart = np.linalg.norm(se3.apply(off, tea_box.eval_points) - tea_box.eval_points, axis=1).mean()
        assert run.quality == 0.9
        assert apart > 0.1 * tea_box.diameter_m
    assert by_cause["shifted"].first[:3, :3] == pytest.approx(np.eye(3))


def test_a_loaded_machine_drops_frames() -> None:
    kept = loaded_schedule(60)
    assert kept[0] == 0
    assert kept == sorted(set(kept))
    assert 30 in kept
    assert 31 not in kept


def test_a_look_alike_has_the_same_shape_and_other_colours() -> None:
    mesh = builtin_meshes(1)["tea_box"]
    other = look_alike(mesh)
    assert other is not None
    assert np.array_equal(other.vertices, mesh.vertices)
    assert not np.array_equal(other.texture, mesh.texture)


def test_figures_of_a_known_run() -> None:
    """Ten frames: three right, two wrong and TRACKING, one wrong and SUSPECT, four right."""
    states = ["TRACKING"] * 5 + ["SUSPECT"] + ["TRACKING"] * 4
    right = [True] * 3 + [False] * 3 + [True] * 4
    frames = [
        (k * FRAME_NS, True, False, state, ok)
        for k, (state, ok) in enumerate(zip(states, right, strict=True))
    ]
    found = figures([{"film": "one", "frames": frames}])
    assert found["false_frames"] == 2
    assert found["false_twice_in_a_row"] == 1
    assert found["coverage"] == pytest.approx(70.0)
    assert found["suspect_after_frames_most"] == 2
    assert found["back_after_s_median"] == pytest.approx(3 / 30, abs=1e-6)


def test_an_object_is_put_away_and_back_at_the_speed_of_a_hand() -> None:
    still = np.tile(np.eye(4), (121, 1, 1))
    path = _leaving(still, np.zeros(3), *AWAY_AT["put away"][1:], np.random.default_rng(0))
    aside = path[:, 0, 3]
    assert aside[[0, 13, 60, 106, 119]] == pytest.approx([0.0, 0.0, 0.9, 0.0, 0.0], abs=0.01)
    assert np.abs(np.diff(np.abs(aside))).max() * 30.0 < 1.2


def test_a_job_played_in_one_mode_is_still_missing_in_the_other() -> None:
    both = ("alone", "with_loop")
    new, half, empty = (Job("report", number, "builtin", None, both) for number in range(3))
    rows = [{"job": half.name, "mode": "alone", "frames": [1]}, {"job": empty.name, "frames": []}]
    left = missing([new, half, empty], rows)
    assert [(job.number, job.modes) for job in left] == [(0, both), (1, ("with_loop",))]
    assert missing([half], [*rows, {"job": half.name, "mode": "with_loop"}]) == []


def test_an_interrupted_run_is_continued_and_other_runs_in_the_folder_do_not_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played = []

    def play(job: Job) -> list[dict]:
        played.append(job.name)
        state = "SUSPECT" if job.objects == "unseen" else "TRACKING"
        one = {"job": job.name, "mode": "alone", "cause": "step 1", "film": job.name}
        return [one | {"frames": [(0, True, False, state, True)] * 5}] * 2

    def run(*words: str) -> dict:
        command = ["stress", "--out", str(tmp_path), "--films", "3", "--modes", "alone", *words]
        monkeypatch.setattr(sys, "argv", command)
        stress.main()
        return json.loads((tmp_path / "summary.json").read_text())["alone"]["all"]

    monkeypatch.setattr(stress, "ProcessPoolExecutor", lambda count, _: ThreadPoolExecutor(count))
    monkeypatch.setattr(stress, "models_of", lambda *_: {})
    monkeypatch.setattr(stress, "played", play)
    assert run()["runs"] == 6
    kept = tmp_path / "rows.jsonl"
    kept.write_bytes(kept.read_bytes()[:-20])  # ended while it wrote the last film
    found = run()
    assert (found["runs"], found["coverage"], len(played)) == (6, 100.0, 4)
    found = run("--objects", "unseen")
    assert (found["runs"], found["coverage"]) == (6, 0.0)
    assert run()["coverage"] == 100.0
