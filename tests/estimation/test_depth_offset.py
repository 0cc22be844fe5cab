"""An offset of colour from depth is noticed, with its size and direction; noise and occluded rims give
none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation.depth_offset import DepthOffset, depth_offset
from huepose.geometry import RgbdFrame
from huepose.model.types import ReferenceModel
from tests.conftest import TakePicture


@pytest.fixture(scope="module")
def frame(tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray) -> RgbdFrame:
    return take_picture([(tea_box.mesh, standing)], light=(0.9, 0.8, 0.6))


@pytest.mark.parametrize(("right", "down"), [(0, 0), (3, -2), (-4, 0), (0, 5)])
def test_the_size_and_direction_of_an_offset_are_measured(
    frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray, right: int, down: int
) -> None:
    carried = replace(frame, color=np.roll(frame.color, (down, right), axis=(0, 1)))
    found = depth_offset(carried, [(tea_box, standing)])
    assert found is not None
    assert np.hypot(found.right_px - right, found.down_px - down) <= 0.75
    assert found.clear == bool(right or down)


def test_noise_has_no_offset(tea_box: ReferenceModel, frame: RgbdFrame, standing: np.ndarray) -> None:
    noise = np.random.default_rng(0).integers(0, 255, frame.color.shape).astype(np.uint8)
    found = depth_offset(replace(frame, color=noise), [(tea_box, standing)])
    assert found is not None
    assert not found.clear


def test_an_occluded_outline_says_nothing(
    frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    wall = replace(frame, depth=np.full_like(frame.depth, 0.2))
    assert depth_offset(wall, [(tea_box, standing)]) is None
    assert depth_offset(frame, []) is None


def test_outlines_may_have_more_points_than_an_image_of_opencv_rows(
    frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    carried = replace(frame, color=np.roll(frame.color, (-2, 3), axis=(0, 1)))
    one = depth_offset(carried, [(tea_box, standing)])
    assert one is not None
    often = 40_000 // one.points
    many = depth_offset(carried, [(tea_box, standing)] * often)
    assert many is not None
    assert (many.right_px, many.down_px, many.points) == (one.right_px, one.down_px, often * one.points)


def test_the_finding_is_said_in_words() -> None:
    said = "The image shows outlines 3.0 px to the left and 1.5 px below where depth has them"
    assert str(DepthOffset(-3.0, 1.5, 9.0, 400)) == said
    assert str(DepthOffset(3.0, 0.0, 9.0, 400)).endswith(" 3.0 px to the right of where depth has them")
    assert not DepthOffset(-3.0, 1.5, 2.0, 400).clear
    assert not DepthOffset(0.25, 0.5, 9.0, 400).clear
