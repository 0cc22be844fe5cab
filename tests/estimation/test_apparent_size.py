"""A camera matrix, a depth scale or a mesh that is wrong by a tenth shows in the size of sure objects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation import Estimator, ObjectQuery
from huepose.estimation.apparent_size import SCALES, USUAL, ApparentSize, apparent_size
from huepose.geometry import Camera, RgbdFrame
from huepose.judge.silhouette import projected_box
from huepose.model.types import ReferenceModel


def seen_in(frame: RgbdFrame, model: ReferenceModel, true_frame: RgbdFrame, T: np.ndarray) -> ApparentSize:
    """The apparent size by the estimator's answer about a frame, in the object's true box."""
    box = projected_box(model, true_frame, T)
    estimator = Estimator({model.name: model})
    answers = estimator.estimate(frame, [ObjectQuery(model.name, box)])
    assert answers[0].state == "TRACKING"
    return apparent_size(estimator.sizes_seen(frame, answers))


def test_a_right_camera_shows_objects_in_their_size(
    box_frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    size = seen_in(box_frame, tea_box, box_frame, standing)
    assert abs(size.larger) <= 0.02
    assert not size.clear


def test_a_focal_length_a_tenth_too_small_shows_them_larger(
    box_frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    camera = replace(box_frame.camera, fx=0.9 * box_frame.camera.fx, fy=0.9 * box_frame.camera.fy)
    size = seen_in(replace(box_frame, camera=camera), tea_box, box_frame, standing)
    assert size.clear
    assert size.larger == pytest.approx(1.0 / 0.9 - 1.0, abs=0.03)
    said = size.said(camera)
    assert said.startswith(f"The image shows objects {100 * size.larger:.0f} % larger")
    assert "are too small, the depth scale is too large, or the mesh is too small" in said


def test_depth_a_tenth_too_small_shows_them_smaller(
    box_frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    near = replace(box_frame, depth=box_frame.depth * np.float32(0.93))
    size = seen_in(near, tea_box, box_frame, standing)
    assert size.clear
    assert size.larger == pytest.approx(-0.07, abs=0.03)


def test_looks_add_up_and_no_look_gives_no_size() -> None:
    weak = np.where(np.isclose(SCALES, 0.08), 4.0, 0.0)[None]
    assert not apparent_size([]).clear
    assert not apparent_size([weak]).clear
    three = apparent_size([weak, weak, weak])
    assert three.clear
    assert three.larger == pytest.approx(0.08)
    usual = np.where(np.abs(SCALES) <= USUAL - 0.005, 40.0, 0.0)[None]
    assert not apparent_size([usual]).clear
    assert "smaller" in ApparentSize(-0.1, 20.0).said(Camera(600.0, 600.0, 320.0, 240.0, 640, 480))


@pytest.mark.parametrize(("at", "clear"), [(0, False), (1, True), (-2, True), (-1, False)])
def test_the_best_at_an_end_of_the_search_is_no_size(at: int, clear: bool) -> None:
    support = np.zeros((1, len(SCALES)))
    support[0, at] = 100.0
    assert apparent_size([support]).clear is clear
