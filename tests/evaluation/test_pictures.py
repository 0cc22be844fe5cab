"""Plots of results: right is green, wrong is red; the files are in the documented folders."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.believe.state import State
from huepose.evaluation import pictures
from huepose.evaluation.estimate_protocol import EstimateOptions, evaluate_estimates
from huepose.evaluation.pictures import RIGHT, TRUTH, WRONG, PictureFolder, draw_rows
from huepose.evaluation.sources import TruthSource
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_protocol import Sources, TrackOptions, evaluate_tracking
from huepose.geometry import se3
from huepose.support.errors import InputError
from huepose.tracking.types import Applied, TrackedPose

from .conftest import MemoryScene, ScriptedEstimator, estimate_of, pose_at, truth

SCENE = MemoryScene("000001", {i: (truth(0, 5, pose_at(-0.08)), truth(1, 7, pose_at(0.1))) for i in (0, 4)})


def has(picture: np.ndarray, color: tuple[int, int, int]) -> bool:
    return bool((np.abs(picture[:120].astype(int) - color) < 60).all(-1).any())


def shifted(frame, query) -> object:
    """The exact pose for the box, a pose 4 cm off for the brick."""
    T = SCENE.truths(frame.frame_id)[query.instance].T_cam_obj
    return estimate_of(query, se3.perturb(T, np.array([0.04 * query.instance, 0, 0, 0, 0, 0])))


def estimated(models, **options):
    frames = []
    evaluate_estimates(
        [SCENE], Targets(models), ScriptedEstimator(shifted), EstimateOptions(), **options,
        on_frame=lambda sample, rows: frames.append((sample, rows)),
    )  # fmt: skip
    return frames


def test_right_is_green_and_wrong_is_red_beside_the_label(models) -> None:
    frames = estimated(models)
    sample, rows = frames[0]
    targets = Targets(models)
    right, wrong = draw_rows(sample, rows[:1], targets), draw_rows(sample, rows[1:], targets)
    assert (has(right, RIGHT), has(right, WRONG)) == (True, False)
    assert (has(wrong, RIGHT), has(wrong, WRONG), has(wrong, TRUTH)) == (False, True, True)
    assert right.shape[0] > 120  # the list is below the image
    assert right.shape[1:] == (160, 3)
    assert not sample.frame.color.any()  # the frame itself does not change


def test_files_of_an_estimation(models, tmp_path: Path) -> None:
    frames = estimated(models)
    folder = PictureFolder(tmp_path / "plots", Targets(models))
    for sample, rows in frames:
        folder.frame(sample, rows)
    names = sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*.png"))
    assert names == [f"plots/frames/000001_{image}_s0.png" for image in ("000000", "000004")]
    picture = cv2.imread(str(tmp_path / "plots" / "frames" / "000001_000000_s0.png"))
    np.testing.assert_array_equal(picture[..., ::-1], draw_rows(*frames[0], Targets(models)))


class Resting:
    """A tracker that publishes the corrected poses and loses the brick on the second frame."""

    def __init__(self) -> None:
        self.corrections = []

    def correct(self, correction):
        self.corrections.append(correction)
        return Applied.CATCHING_UP

    def step(self, frame):
        lost = frame.frame_id > 0
        return [
            TrackedPose(c.object, c.instance, 0, frame.frame_id, frame.stamp_ns,
                        State.LOST if lost and c.object == "brick" else State.TRACKING,
                        None if lost and c.object == "brick" else c.T_cam_obj, None, 0.9, None, 1)
            for c in self.corrections
        ]  # fmt: skip


def test_files_of_a_tracking_run(models, tmp_path: Path) -> None:
    folder = PictureFolder(tmp_path, Targets(models))
    result = evaluate_tracking(
        [SCENE], Targets(models), lambda known: Resting(), lambda scene, seed: Sources(TruthSource()),
        TrackOptions(), on_frame=folder.frame,
    )  # fmt: skip
    folder.tracks(result)
    names = sorted(p.name for p in tmp_path.rglob("*.png"))
    assert names == ["000001_000000_s0.png", "000001_000004_s0.png", "errors_000001.png"]


def test_each_seed_has_its_own_line(models, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = {}
    monkeypatch.setattr(
        pictures, "line_plot", lambda lines, *_, **__: drawn.update(lines) or np.zeros((4, 4))
    )
    result = evaluate_tracking(
        [SCENE], Targets(models), lambda known: Resting(), lambda scene, seed: Sources(TruthSource()),
        TrackOptions(seeds=(0, 3)),
    )  # fmt: skip
    PictureFolder(tmp_path, Targets(models)).tracks(result)
    assert list(drawn) == ["5/0, seed 0", "7/0, seed 0", "5/0, seed 3", "7/0, seed 3"]
    assert all((np.diff(frames) > 0).all() for frames, _ in drawn.values())


def test_the_error_names_a_folder_that_cannot_be_made(models, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    frames = estimated(models)
    with pytest.raises(InputError, match="file/plots"):
        PictureFolder(tmp_path / "file" / "plots", Targets(models)).frame(*frames[0])
