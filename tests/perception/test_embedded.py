"""The depth segmenter: what stands on a table is outlined, one or several pieces of it, alone or touching."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Box, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.perception.color_cut import color_cut
from huepose.perception.embedded import DepthSegmenter
from huepose.perception.support_plane import above_plane, find_support_plane
from huepose.rendering.render import render_depth

TakePicture = Callable[..., RgbdFrame]


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


@pytest.fixture(scope="module")
def frame(tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray) -> RgbdFrame:
    clean = take_picture([(tea_box.mesh, standing)])
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.001, clean.depth.shape).astype(np.float32)
    return replace(clean, depth=np.where(clean.depth > 0, clean.depth + noise, 0).astype(np.float32))


@pytest.fixture(scope="module")
def truth(frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray) -> np.ndarray:
    return render_depth(tea_box.mesh, standing, frame.camera) > 0


def test_the_plane_of_the_table_is_found(frame: RgbdFrame, truth: np.ndarray) -> None:
    box = Box.of_mask(truth)
    assert box is not None
    plane = find_support_plane(frame.depth, frame.camera, box)
    assert plane is not None
    tilt = np.radians(35.0)
    assert plane.normal @ np.array([0, -np.cos(tilt), -np.sin(tilt)]) > np.cos(np.radians(0.5))
    standing_clear = above_plane(frame.depth, frame.camera, plane)
    assert iou(standing_clear, truth) > 0.9


@pytest.mark.parametrize(("shift", "scale"), [((0.0, 0.0), 1.0), ((0.08, -0.08), 1.1), ((-0.1, 0.05), 0.9)])
def test_a_box_on_a_table_is_outlined(
    frame: RgbdFrame, truth: np.ndarray, tea_box: ReferenceModel, shift: tuple[float, float], scale: float
) -> None:
    exact = Box.of_mask(truth)
    assert exact is not None
    w, h = exact.w * scale, exact.h * scale
    box = Box(
        exact.x + exact.w / 2 + shift[0] * exact.w - w / 2,
        exact.y + exact.h / 2 + shift[1] * exact.h - h / 2,
        w,
        h,
    )
    masks = DepthSegmenter().segment(frame, box, tea_box.diameter_m)
    assert iou(masks[0], truth) > (0.9 if scale >= 1.0 else 0.85)
    again = DepthSegmenter().segment(frame, box, tea_box.diameter_m)
    assert len(again) == len(masks)
    assert all(np.array_equal(a, b) for a, b in zip(masks, again, strict=True))


def test_pieces_on_both_sides_of_a_stick_are_joined(
    frame: RgbdFrame, truth: np.ndarray, tea_box: ReferenceModel
) -> None:
    box = Box.of_mask(truth)
    assert box is not None
    middle = int(box.x + box.w / 2)
    depth = frame.depth.copy()
    depth[:, middle - 3 : middle + 4] = 0.35
    split = replace(frame, depth=depth)
    visible = truth & (depth > 0.4)
    masks = DepthSegmenter().segment(split, box, tea_box.diameter_m)
    assert max(iou(m, visible) for m in masks) > 0.85
    assert not any(m[:, middle].any() for m in masks)


def test_a_neighbour_behind_is_left_out(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    behind = se3.compose(se3.make(np.eye(3), np.array([0.05, -0.06, 0.12])), standing)
    frame = take_picture([(tea_box.mesh, standing), (tea_box.mesh, behind)])
    truth = render_depth(tea_box.mesh, standing, frame.camera) > 0
    box = Box.of_mask(truth)
    assert box is not None
    assert iou(DepthSegmenter().segment(frame, box, tea_box.diameter_m)[0], truth) > 0.9


def test_color_cuts_what_depth_cannot() -> None:
    """Two things of one depth that touch: colour finds the seam."""
    rng = np.random.default_rng(3)
    color = np.full((200, 240, 3), (90, 90, 90), np.int16)
    color[50:150, 60:120] = (200, 40, 30)
    color[50:150, 120:200] = (30, 60, 190)
    noisy = np.clip(color + rng.normal(0, 6, color.shape), 0, 255).astype(np.uint8)
    mask = np.zeros((200, 240), bool)
    mask[50:150, 60:128] = True
    truth = np.zeros_like(mask)
    truth[50:150, 60:120] = True
    box = Box(60, 50, 60, 100)
    cut = color_cut(noisy, box, mask)
    assert iou(cut, truth) > 0.9
    assert (cut & ~truth).sum() < 0.5 * (mask & ~truth).sum()
    assert np.array_equal(cut, color_cut(noisy, box, mask))


def test_no_depth_gives_one_empty_mask(frame: RgbdFrame) -> None:
    blind = replace(frame, depth=np.zeros_like(frame.depth))
    masks = DepthSegmenter().segment(blind, Box(200, 150, 80, 90), 0.2)
    assert len(masks) == 1
    assert not masks[0].any()


def test_a_box_outside_of_the_image_gives_one_empty_mask(frame: RgbdFrame) -> None:
    for box in (Box(-300, 10, 100, 100), Box(700, 500, 50, 50), Box(100, 100, 0, 0)):
        masks = DepthSegmenter().segment(frame, box, 0.2)
        assert len(masks) == 1
        assert not masks[0].any()
