"""From flow to motion: each step is compared with a known result."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from huepose.geometry import Box, Camera, RgbdFrame, se3
from huepose.geometry.lifting import lift
from huepose.paper.correspondences import match, propagate
from huepose.paper.relative_pose import LiftedMatches, lift_matches, robust_kabsch
from huepose.propose import flow as optical_flow

ALL = Box(0, 0, 200, 160)


def texture(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rough = rng.integers(0, 255, (40, 50, 3)).astype(np.float32)
    fine = cv2.resize(rough, (240, 200), interpolation=cv2.INTER_CUBIC)
    return np.clip(cv2.GaussianBlur(fine, (0, 0), 1.0), 0, 255).astype(np.uint8)


def shifted(du: int, dv: int) -> tuple[np.ndarray, np.ndarray]:
    """Two images of 200 x 160; the point (u, v) of the first is at (u + du, v + dv) in the second."""
    t = texture()
    return t[20:180, 20:220].copy(), t[20 - dv : 180 - dv, 20 - du : 220 - du].copy()


@pytest.mark.parametrize(("du", "dv"), [(0, 0), (3, 0), (0, -4), (7, 5), (-12, 9)])
def test_the_flow_of_a_pure_translation_is_found(du: int, dv: int) -> None:
    a, b = shifted(du, dv)
    flow = optical_flow.compute(a, b, ALL)
    assert flow is not None
    inner = np.s_[25:-25, 25:-25]
    error = np.linalg.norm(flow.forward[inner] - [du, dv], axis=2)
    assert np.median(error) < 0.2
    assert flow.consistent[inner].mean() > 0.85


def test_flow_in_a_window_has_pixel_coordinates_of_the_frame() -> None:
    a, b = shifted(4, 2)
    flow = optical_flow.compute(a, b, Box(60, 40, 90, 80))
    assert flow is not None
    assert (flow.x0, flow.y0) == (60, 40)
    moved, good = flow.at(np.array([[100.0, 80.0], [120.5, 90.25], [10.0, 10.0]]))
    np.testing.assert_allclose(moved[:2], [[4, 2], [4, 2]], atol=0.2)
    assert good.tolist() == [True, True, False]


def test_a_window_that_is_too_small_has_no_flow() -> None:
    a, b = shifted(0, 0)
    assert optical_flow.compute(a, b, Box(190, 10, 60, 60)) is None


def test_a_mask_moves_with_the_flow() -> None:
    a, b = shifted(6, -3)
    mask = np.zeros((160, 200), bool)
    mask[60:100, 70:120] = True
    flow = optical_flow.compute(a, b, ALL)
    assert flow is not None
    moved = propagate(mask, flow)
    expected = np.roll(mask, (-3, 6), (0, 1))
    assert (moved & expected).sum() / (moved | expected).sum() > 0.93


def test_forward_backward_consistency_of_known_fields() -> None:
    forward = np.zeros((40, 60, 2), np.float32)
    forward[..., 0] = 6.0
    backward = np.zeros_like(forward)
    backward[:, :30, 0] = -6.0
    good = optical_flow.consistency(forward, backward)
    assert good[:, :23].all(), "the backward flow returns to the pixel"
    assert not good[:, 25:].any(), "the backward flow does not return"
    assert not good[:, 54:].any(), "out of the window"


def test_depth_is_not_averaged_over_an_edge() -> None:
    camera = Camera(500.0, 500.0, 9.5, 9.5, 20, 20)
    depth = np.full((20, 20), 1.0, np.float32)
    depth[:, :10] = 0.6
    points, known = lift(depth, camera, np.array([[9.3, 5.0], [9.7, 5.0], [3.5, 4.5]]))
    assert known.all()
    np.testing.assert_allclose(points[:, 2], [0.6, 1.0, 0.6], atol=1e-6)


def test_a_slanted_plane_is_lifted_exactly() -> None:
    camera = Camera(500.0, 480.0, 31.5, 23.5, 64, 48)
    normal, offset = np.array([0.2, -0.1, 1.0]), 0.7
    columns, rows = np.meshgrid(np.arange(64), np.arange(48))
    rays = camera.rays(np.stack([columns, rows], -1))
    depth = (offset / (rays @ normal)).astype(np.float32)
    pixels = np.random.default_rng(0).uniform([1, 1], [62, 46], (200, 2))
    points, known = lift(depth, camera, pixels)
    assert known.all()
    np.testing.assert_allclose(points @ normal, offset, atol=2e-5)
    np.testing.assert_allclose(camera.project(points), pixels, atol=1e-6)


def test_unknown_depth_stays_unknown() -> None:
    camera = Camera(500.0, 500.0, 9.5, 9.5, 20, 20)
    depth = np.full((20, 20), 0.8, np.float32)
    depth[5, 5], depth[10, 10] = 0.0, np.nan
    depth[15, 15] = 0.3  # a flying pixel: no neighbour confirms it
    pixels = np.array([[5.0, 5.0], [10.0, 10.0], [15.0, 15.0], [-2.0, 3.0], [np.nan, 3.0], [19.0, 19.0]])
    _, known = lift(depth, camera, pixels)
    assert known.tolist() == [False, False, False, False, False, True]


def test_the_relative_pose_is_robust_to_a_third_of_wrong_matches() -> None:
    rng = np.random.default_rng(3)
    T = se3.make(se3.rotation_exp(np.array([0.2, -0.4, 0.1])), np.array([0.05, -0.02, 0.03]))
    a = rng.uniform([-0.05, -0.05, 0.55], [0.05, 0.05, 0.65], (90, 3))
    b = se3.apply(T, a)
    b[:30] += rng.uniform(0.02, 0.1, (30, 3))
    motion = robust_kabsch(LiftedMatches(a, b, np.ones(90)))
    assert motion is not None
    np.testing.assert_allclose(motion, T, atol=1e-9)


def test_too_few_matches_have_no_relative_pose() -> None:
    few = np.zeros((4, 3))
    assert robust_kabsch(LiftedMatches(few, few, np.ones(4))) is None


def test_colour_pairs_drop_matches_whose_texture_changed() -> None:
    """Half of the image gets another hue: flow (on lightness) still matches there, colour pairs do not."""
    a, b = shifted(3, 1)
    lab = cv2.cvtColor(b, cv2.COLOR_RGB2LAB)
    left = lab[:, :100].astype(np.int32)
    left[..., 1:] = 255 - left[..., 1:]
    lab[:, :100] = left.clip(0, 255).astype(np.uint8)
    b = cv2.cvtColor(lab, cv2.COLOR_LAB2RGB)
    mask = np.zeros((160, 200), bool)
    mask[20:140, 20:180] = True
    flow = optical_flow.compute(a, b, ALL)
    assert flow is not None
    plain = match(a, b, mask, flow, use_pairs=False)
    paired = match(a, b, mask, flow)

    def share_left(m: np.ndarray) -> float:
        return float((m[:, 0] < 95).mean())

    assert 0.3 < share_left(plain.pixels_a) < 0.7
    assert share_left(paired.pixels_a) < 0.25
    assert len(paired) > 100, "ridge points are added to the grid"
    inner = paired.pixels_a[:, 0] > 105
    offsets = (paired.pixels_b - paired.pixels_a)[inner]
    np.testing.assert_allclose(np.median(offsets, axis=0), [3, 1], atol=0.2)


def test_matches_of_a_moved_plane_give_its_motion() -> None:
    """A printed plane 0.5 m away moves by 6 x 4 mm: flow, matching, lifting and registration."""
    camera = Camera(400.0, 400.0, 99.5, 79.5, 200, 160)
    a, b = shifted(5, 3)
    depth = np.full((160, 200), 0.5, np.float32)
    frames = [RgbdFrame(np.ascontiguousarray(c), depth, camera) for c in (a, b)]
    mask = np.zeros((160, 200), bool)
    mask[30:130, 30:170] = True
    flow = optical_flow.compute(a, b, ALL)
    assert flow is not None
    motion = robust_kabsch(lift_matches(frames[0], frames[1], match(a, b, mask, flow)))
    assert motion is not None
    expected = se3.make(np.eye(3), np.array([5, 3, 0]) / 400.0 * 0.5)
    np.testing.assert_allclose(motion[:3, 3], expected[:3, 3], atol=5e-4)
    assert se3.rotation_angle(motion, expected) < np.radians(0.3)
