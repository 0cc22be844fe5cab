"""The sensors against their formulas."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from huepose.geometry import Camera
from huepose.scenes.camera import COLOR, STEREO
from huepose.scenes.sensor import expose, gaussian, stereo_depth

CAMERA = Camera(614.2, 614.6, 159.5, 119.5, 320, 240)
FACING = np.zeros((240, 320, 3), np.float32)
FACING[..., 2] = -1.0
SURE = replace(STEREO, holes=0.0, edge_holes=0.0, flying=0.0)


def flat(depth_m: float) -> np.ndarray:
    return np.full((240, 320), depth_m, np.float32)


@pytest.mark.parametrize("depth_m", [0.5, 0.8, 1.5])
def test_noise_of_a_wall_has_the_stated_rms_and_no_bias(depth_m: float) -> None:
    seen = np.concatenate(
        [stereo_depth(flat(depth_m), FACING, CAMERA, STEREO, np.random.default_rng(k)) for k in range(4)]
    )
    error = (seen - depth_m)[seen > 0]
    expected = STEREO.rms_m(depth_m, CAMERA)
    assert expected == pytest.approx(depth_m**2 * 0.08 / (614.2 * 0.05))
    assert error.std() == pytest.approx(expected, rel=0.1)
    assert abs(error.mean()) < 0.12 * expected


def test_noise_is_correlated_within_the_matching_window_only() -> None:
    seen = stereo_depth(flat(0.8), FACING, CAMERA, SURE, np.random.default_rng(1))
    e = np.where(seen > 0, seen - 0.8, 0.0)
    power = float((e * e).mean())
    assert 0.4 < (e[:, 3:] * e[:, :-3]).mean() / power < 0.7
    assert abs((e[:, 12:] * e[:, :-12]).mean() / power) < 0.08


def test_holes_grow_with_distance_and_at_grazing_angles() -> None:
    def lost(depth_m: float, normals: np.ndarray) -> float:
        seen = stereo_depth(flat(depth_m), normals, CAMERA, STEREO, np.random.default_rng(3))
        return float((seen == 0).mean())

    near, far = lost(0.5, FACING), lost(1.6, FACING)
    assert 0.0005 < near < 0.02
    assert far > 2 * near
    slanted = np.zeros_like(FACING)
    slanted[..., 0], slanted[..., 2] = np.sin(np.radians(78)), -np.cos(np.radians(78))
    assert lost(0.5, slanted) > 0.25


def test_the_stereo_shadow_left_of_a_near_object_is_as_wide_as_the_disparity_step() -> None:
    depth = flat(1.0)
    depth[60:180, 150:220] = 0.5
    seen = stereo_depth(depth, FACING, CAMERA, SURE, np.random.default_rng(4))
    width = CAMERA.fx * 0.05 * (1 / 0.5 - 1 / 1.0)
    left = seen[80:160, 150 - 45 : 150]
    assert (left == 0).mean() * 45 == pytest.approx(width, abs=3.0)
    assert (seen[80:160, 225:270] == 0).mean() < 0.03
    inner = seen[80:160, 156:214]
    assert (inner > 0).mean() > 0.98
    assert np.median(inner[inner > 0]) == pytest.approx(0.5, abs=0.001)


def test_depth_edges_are_ragged_and_have_flying_pixels() -> None:
    depth = flat(1.0)
    depth[60:180, 150:220] = 0.5
    seen = stereo_depth(depth, FACING, CAMERA, replace(SURE, flying=0.3), np.random.default_rng(4))
    wrong = (seen > 0) & (np.abs(seen - depth) > 0.05)
    border = cv2.dilate((depth < 0.7).astype(np.uint8), np.ones((9, 9))) - cv2.erode(
        (depth < 0.7).astype(np.uint8), np.ones((9, 9))
    )
    assert wrong.sum() > 100
    assert not wrong[border == 0].any()
    between = (seen > 0.55) & (seen < 0.9)
    assert between.sum() > 20


def test_without_a_surface_there_is_no_depth() -> None:
    depth = flat(0.8)
    depth[:, 200:] = 0
    assert not stereo_depth(depth, FACING, CAMERA, SURE, np.random.default_rng(0))[:, 206:].any()


def test_colour_noise_is_shot_noise_and_black_stays_dark() -> None:
    linear = np.full((200, 200, 3), 0.5, np.float32)
    sharp = replace(COLOR, blur_px=0.1)
    image = expose(linear, sharp, np.random.default_rng(0)).astype(float)
    back = (image / 255) ** 2.2
    assert back.mean() == pytest.approx(0.5, abs=0.003)
    assert back.std() == pytest.approx(np.sqrt(0.5 / 6000 + 0.0025**2), rel=0.1)
    assert expose(np.full((50, 50, 3), 3.0, np.float32), sharp, np.random.default_rng(0)).min() == 255
    assert expose(np.zeros((50, 50, 3), np.float32), sharp, np.random.default_rng(0)).mean() < 12


def test_gaussian_samples_are_normally_distributed() -> None:
    x = gaussian(np.random.default_rng(0), (300, 1000))
    assert x.mean() == pytest.approx(0, abs=0.01)
    assert x.std() == pytest.approx(1, abs=0.01)
    assert (np.abs(x) > 2).mean() == pytest.approx(0.0455, abs=0.003)
