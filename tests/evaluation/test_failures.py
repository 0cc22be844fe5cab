"""Wrong poses get a page and a line; right ones get nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.datasets.types import GroundTruth, Sample
from huepose.estimation import Estimator
from huepose.estimation.panels import AGREES, SEEN_THROUGH, Panels
from huepose.evaluation.estimate_protocol import EstimateOptions, evaluate_estimates
from huepose.evaluation.failures import FailureFolder
from huepose.evaluation.targets import Targets
from huepose.geometry import Box, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth

UPSIDE_DOWN = se3.make(np.diag([1.0, -1.0, -1.0]), np.zeros(3))


@dataclass(frozen=True, eq=False)
class OnePicture:
    """A scene of two images: the box labelled as it stands, and labelled upside down."""

    picture: RgbdFrame
    T_cam_obj: np.ndarray
    shown: np.ndarray
    name: str = "000007"

    @property
    def image_ids(self) -> tuple[int, ...]:
        return (0, 1)

    def frame(self, image: int) -> RgbdFrame:
        return self.picture

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        T = self.T_cam_obj @ UPSIDE_DOWN if image else self.T_cam_obj
        return (GroundTruth(3, T, None, "tea_box", 1.0, Box.of_mask(self.shown), lambda: self.shown),)


@pytest.fixture(scope="module")
def scene(
    tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray
) -> OnePicture:
    frame = take_picture([(tea_box.mesh, standing)])
    return OnePicture(frame, standing, render_depth(tea_box.mesh, standing, frame.camera) > 0)


def test_a_page_and_a_line_for_the_wrong_pose_alone(
    scene: OnePicture, tea_box: ReferenceModel, tmp_path: Path
) -> None:
    estimator, targets = Estimator({"tea_box": tea_box}), Targets({"tea_box": tea_box})
    folder = FailureFolder(tmp_path / "failures", targets, estimator, {})
    result = evaluate_estimates([scene], targets, estimator, EstimateOptions(), on_frame=folder.frame)
    assert [row.error.right for row in result.rows] == [True, False]
    assert folder.finish() == "1 wrong poses: 1 verification"
    files = {p.name for p in (tmp_path / "failures").iterdir()}
    assert files == {"000007_000001_3_s0_tea_box.png", "failures.txt", "failures.json"}
    page = cv2.imread(str(tmp_path / "failures" / "000007_000001_3_s0_tea_box.png"))
    assert page.shape[1] > 600
    line = (tmp_path / "failures" / "failures.txt").read_text().splitlines()[0]
    assert line.startswith(
        "000007_000001_3_s0 tea_box (visible 100 %): verification: turned 180 deg about its x"
    )
    (row,) = json.loads((tmp_path / "failures" / "failures.json").read_text())["rows"]
    assert row["mask_iou"] > 0.9
    assert row["answer"]["total"] > row["truth"]["total"] + 0.3


def test_a_declared_pose_is_no_failure(scene: OnePicture, tea_box: ReferenceModel, tmp_path: Path) -> None:
    estimator, targets = Estimator({"tea_box": tea_box}), Targets({"tea_box": tea_box})
    declared = {("000007", 1, 3): [UPSIDE_DOWN]}
    folder = FailureFolder(tmp_path, targets, estimator, declared)
    evaluate_estimates(
        [scene], targets, estimator, EstimateOptions(), equivalents=declared, on_frame=folder.frame
    )
    assert folder.finish() == "0 wrong poses"
    assert (tmp_path / "failures.txt").read_text() == "0 wrong poses\n"


def test_where_a_pose_agrees_is_green_and_where_it_is_in_the_air_red(
    scene: OnePicture, tea_box: ReferenceModel
) -> None:
    box = Box.of_mask(scene.shown)
    assert box is not None
    panels = Panels.around(scene.picture, box, [], 0.008)
    right = panels.judged(tea_box, scene.T_cam_obj)
    nearer = se3.compose(se3.make(np.eye(3), [0.0, 0.0, -0.1]), scene.T_cam_obj)
    wrong = panels.judged(tea_box, nearer)
    share = {
        name: [float((np.abs(p.astype(int) - c).max(-1) < 30).mean()) for c in (AGREES, SEEN_THROUGH)]
        for name, p in (("right", right), ("wrong", wrong))
    }
    assert share["right"][0] > 0.3 > 0.02 > share["right"][1]
    assert share["wrong"][1] > 0.3 > 0.02 > share["wrong"][0]


def test_a_sample_without_a_wrong_row_is_not_looked_at_again(
    scene: OnePicture, tea_box: ReferenceModel, tmp_path: Path
) -> None:
    folder = FailureFolder(tmp_path, Targets({"tea_box": tea_box}), Estimator({}), {})
    folder.frame(Sample(scene.frame(0), scene.truths(0), scene.name, 0), [])  # its estimator knows nothing
    assert folder.finish() == "0 wrong poses"
