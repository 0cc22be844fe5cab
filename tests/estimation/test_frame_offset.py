"""A large offset of depth from colour is noticed without any object; a usual one is not."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from huepose.estimation.frame_offset import frame_offset, steps_of_depth
from huepose.geometry import RgbdFrame
from huepose.model.types import ReferenceModel
from tests.conftest import TakePicture


@pytest.fixture(scope="module")
def frame(tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray) -> RgbdFrame:
    return take_picture([(tea_box.mesh, standing)], light=(0.9, 0.8, 0.6))


@pytest.mark.parametrize(("right", "down"), [(20, 0), (-45, 0), (3, 30), (-25, -15)])
def test_the_size_and_direction_of_an_offset_are_measured(frame: RgbdFrame, right: int, down: int) -> None:
    move = np.array([[1, 0, -right], [0, 1, -down]], np.float32)
    aside = cv2.warpAffine(frame.depth, move, frame.depth.shape[::-1], flags=cv2.INTER_NEAREST)
    found = frame_offset(replace(frame, depth=aside))
    assert found is not None
    assert np.hypot(found.right_px - right, found.down_px - down) <= 4.0


def test_a_large_image_is_measured_like_a_small_one(frame: RgbdFrame) -> None:
    camera = frame.camera
    large = replace(
        frame,
        color=cv2.resize(frame.color, None, fx=2.0, fy=2.0),
        depth=np.ascontiguousarray(np.roll(frame.depth.repeat(2, 0).repeat(2, 1), 60, axis=1)),
        camera=replace(
            camera, fx=2 * camera.fx, fy=2 * camera.fy, width=2 * camera.width, height=2 * camera.height
        ),
    )
    found = frame_offset(large)
    assert found is not None
    assert np.hypot(found.right_px + 60, found.down_px) <= 6.0


def test_depth_that_lies_on_the_colours_is_not_doubted(frame: RgbdFrame) -> None:
    assert frame_offset(frame) is None
    beside = replace(frame, depth=np.ascontiguousarray(np.roll(frame.depth, 5, axis=1)))
    assert frame_offset(beside) is None


def test_noise_and_depth_without_steps_have_no_offset(frame: RgbdFrame) -> None:
    noise = np.random.default_rng(0).integers(0, 255, frame.color.shape).astype(np.uint8)
    assert frame_offset(replace(frame, color=noise)) is None
    for depth in (0.0, 0.8):
        assert frame_offset(replace(frame, depth=np.full_like(frame.depth, depth))) is None


def test_steps_are_on_the_near_side_and_not_beside_holes() -> None:
    depth = np.full((40, 60), 1.0, np.float32)
    depth[10:30, 20:40] = 0.8
    steps = steps_of_depth(depth)
    ring = np.zeros_like(steps)
    ring[10:30, 20:40] = True
    ring[11:29, 21:39] = False
    assert np.array_equal(steps, ring)
    depth[depth == 1.0] = 0.0
    assert not steps_of_depth(depth).any()
