"""The depth segmenter outlines objects on a table: in one or several pieces, alone or touching."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Box, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.perception.embedded import DepthSegmenter, color_cut, cut_pieces, depth_steps
from huepose.perception.planes import NEAR_M, _near_plane, _outside, above_plane, find_support_plane
from huepose.rendering.render import render_depth
from tests.conftest import TakePicture


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


@pytest.fixture(scope="module")
def frame(box_frame: RgbdFrame) -> RgbdFrame:
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.001, box_frame.depth.shape).astype(np.float32)
    return replace(
        box_frame, depth=np.where(box_frame.depth > 0, box_frame.depth + noise, 0).astype(np.float32)
    )


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
    """Two touching objects at one depth: colour finds the seam."""
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


def test_shares_and_weights_of_two_pieces_are_those_of_the_formula() -> None:
    depth = np.full((40, 60), 0.8, np.float32)
    depth[:, 30:] = 1.2  # a step: two pieces
    box = Box(12.5, 6.0, 30.0, 25.0)
    pieces = cut_pieces(depth, depth > 0, box)
    v, u = np.mgrid[:40, :60]
    inside = (u >= box.x) & (u < box.x1) & (v >= box.y) & (v < box.y1)
    near = np.exp(-0.5 * ((v - box.y - box.h / 2) / (0.45 * box.h)) ** 2)
    near = near * np.exp(-0.5 * ((u - box.x - box.w / 2) / (0.45 * box.w)) ** 2)
    assert len(pieces.weight) == 2
    for k in range(2):
        piece = pieces.labels == k
        np.testing.assert_allclose(pieces.share[k], inside[piece].mean(), rtol=1e-12)
        np.testing.assert_allclose(pieces.weight[k], near[piece].sum(), rtol=1e-12)


def test_the_ring_round_a_box_is_what_lies_outside_of_it_and_has_depth() -> None:
    depth = np.ones((21, 33), np.float32)
    depth[4, 6] = depth[0, 0] = 0.0
    box = (7.5, 6.0, 20.0, 15.5)
    v, u = np.mgrid[:21:2, :33:2]
    inside = (u > box[0]) & (u < box[2]) & (v > box[1]) & (v < box[3])
    expected = np.flatnonzero(~inside & (depth[::2, ::2] > 0))
    found = _outside(np.ascontiguousarray(depth[::2, ::2]), box[0], box[1], box[2], box[3])
    np.testing.assert_array_equal(found, expected)


def test_the_spread_of_a_plane_has_its_normal() -> None:
    rng = np.random.default_rng(0)
    normal = np.array([0.3, -0.5, -0.81])
    normal /= np.linalg.norm(normal)
    points = rng.uniform(-0.3, 0.3, (400, 3))
    points -= np.outer(points @ normal + rng.normal(0.0, 0.004, 400), normal)
    point = np.zeros(3)
    near = points[np.abs((points - point) @ normal) < NEAR_M]
    count, mean, spread = _near_plane(points, normal, point)
    assert count == len(near) < 400
    np.testing.assert_allclose(mean, near.mean(0), atol=1e-12)
    found = np.linalg.eigh(spread)[1][:, 0]
    expected = np.linalg.svd(near - near.mean(0), full_matrices=False)[2][2]
    np.testing.assert_allclose(abs(found @ expected), 1.0, atol=1e-12)


def test_of_a_step_in_depth_the_far_side_is_marked() -> None:
    depth = np.full((12, 14), 0.7, np.float32)
    depth[3:9, 4:10] = 0.6
    right = np.zeros(depth.shape, bool)
    right[4:8, [3, 10]] = right[[2, 9], 5:9] = True
    corners = np.zeros_like(right)  # which the median of nine rounds off
    corners[2:5, 3:6] = corners[2:5, 8:11] = corners[7:10, 3:6] = corners[7:10, 8:11] = True
    assert np.array_equal(depth_steps(depth) & ~corners, right & ~corners)
    across = 0.6 + 0.0087 * np.arange(14, dtype=np.float32)  # steeper than the limit at 0.6 m, not at 0.7 m
    slope = depth_steps(np.tile(across, (12, 1)))
    assert slope[:, 1].all()
    assert not slope[:, 0].any()
    assert not slope[:, -2:].any()
