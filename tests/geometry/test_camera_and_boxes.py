from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Box, Camera, RgbdFrame
from huepose.geometry.box import given_box
from huepose.geometry.camera import FLOOR_M, depth_noise_m
from huepose.support.errors import InputError

CAMERA = Camera(600.0, 610.0, 319.5, 239.5, 640, 480)


def test_projection_and_back():
    points = np.array([[0.1, -0.05, 0.8], [0.0, 0.0, 1.0]])
    pixels = CAMERA.project(points)
    np.testing.assert_allclose(pixels[1], [319.5, 239.5])
    np.testing.assert_allclose(pixels[0], [600 * 0.125 + 319.5, -610 * 0.0625 + 239.5])
    np.testing.assert_allclose(CAMERA.backproject(pixels, points[:, 2]), points, atol=1e-12)


def test_behind_the_camera_is_nan():
    assert np.isnan(CAMERA.project(np.array([0.0, 0.0, -1.0]))).all()


def test_crop_moves_pixels_by_its_corner():
    point = np.array([0.1, 0.1, 0.7])
    np.testing.assert_allclose(
        CAMERA.cropped(20, 30, 50, 60).project(point), CAMERA.project(point) - [20, 30]
    )


def test_scaling_keeps_pixel_areas():
    """The outer corner of the image, half a pixel outside the first centre, stays the outer corner."""
    corner = CAMERA.rays(np.array([-0.5, -0.5]))
    np.testing.assert_allclose(CAMERA.scaled(0.5).project(corner), [-0.5, -0.5], atol=1e-12)


@pytest.mark.parametrize(("width", "height"), [(640, 480), (641, 481), (425, 241), (853, 480), (1280, 2)])
@pytest.mark.parametrize("factor", [0.5, 0.375, 0.25])
def test_scaling_to_whole_pixels_keeps_all_corners(width: int, height: int, factor: float) -> None:
    """As in a resized image, which has no half pixels."""
    camera = Camera(600.0, 610.0, 0.4 * width, 0.6 * height, width, height)
    small = camera.scaled(factor)
    assert (small.width, small.height) == (round(factor * width), max(1, round(factor * height)))
    corner = camera.rays(np.array([width - 0.5, height - 0.5]))
    np.testing.assert_allclose(small.project(corner), [small.width - 0.5, small.height - 0.5], atol=1e-9)


@pytest.mark.parametrize("fault", [{"fx": 0.0}, {"fy": -600.0}, {"fx": np.nan}, {"cx": np.inf}])
def test_intrinsics_that_no_camera_has_are_refused_with_their_numbers(fault: dict[str, float]) -> None:
    numbers = {"fx": 600.0, "fy": 600.0, "cx": 320.0, "cy": 240.0, **fault}
    with pytest.raises(InputError, match=f"camera intrinsics: found fx {numbers['fx']:g}, "):
        Camera(**numbers, width=640, height=480)


def test_box_iou_and_mask_bounds():
    assert Box(0, 0, 2, 2).iou(Box(1, 0, 2, 2)) == pytest.approx(1 / 3)
    assert Box(0, 0, 1, 1).iou(Box(5, 5, 1, 1)) == 0
    mask = np.zeros((10, 12), bool)
    mask[2:5, 7:9] = True
    assert Box.of_mask(mask) == Box(7, 2, 2, 3)
    assert Box.of_mask(np.zeros((3, 3), bool)) is None
    assert Box(-5, 2, 10, 100).clipped(640, 50) == Box(0, 2, 5, 48)


@pytest.mark.parametrize(
    "numbers",
    [(1, 2, 0, 5), (1, 2, 5, -5), (640, 2, 30, 50), (-30, 2, 30, 50), (1, 480, 30, 50), (np.nan, 2, 30, 50)],
)
def test_a_given_box_without_a_pixel_of_the_image_is_refused_with_its_size(numbers):
    with pytest.raises(InputError, match="in the image of 640 x 480"):
        given_box(numbers, (640, 480))


def test_a_given_box_may_reach_out_of_the_image_and_is_unchanged():
    assert (
        given_box((600, -20, 90, 160), (640, 480)) == given_box((600, -20, 90, 160)) == Box(600, -20, 90, 160)
    )


def test_box_of_pixels_covers_their_centres():
    assert Box.of_pixels(np.array([[3.0, 4.0], [5.0, 4.0]])) == Box(3, 4, 3, 1)


def test_depth_of_another_size_is_refused_by_name():
    with pytest.raises(InputError, match="depth image: found \\(240, 320\\)"):
        RgbdFrame(np.zeros((480, 640, 3), np.uint8), np.zeros((240, 320), np.float32), CAMERA)


@pytest.mark.parametrize(
    ("dtype", "fix"),
    [(np.uint16, r"astype\(np.float32\) \* 0.001"), (np.float64, r"depth.astype\(np.float32\)\.")],
)
def test_depth_of_another_type_is_refused_with_what_it_most_likely_is(dtype: type, fix: str) -> None:
    with pytest.raises(InputError, match=fix):
        RgbdFrame(np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), dtype), CAMERA)


@pytest.mark.parametrize(
    ("color", "fix"),
    [
        (np.zeros((480, 640, 4), np.uint8), r"color\[..., :3\]"),
        (np.zeros((480, 640), np.uint8), "A grey image is not enough"),
        (np.zeros((480, 640, 3), np.float32), r"\(color \* 255\).astype"),
        (np.zeros((240, 320, 3), np.uint8), "belong together"),
    ],
)
def test_a_colour_image_of_another_form_is_refused_with_what_to_do(color: np.ndarray, fix: str) -> None:
    with pytest.raises(InputError, match=fix):
        RgbdFrame(color, np.zeros((480, 640), np.float32), CAMERA)


def test_a_frame_without_depth_or_camera_is_refused_with_what_to_do() -> None:
    camera = Camera(600.0, 600.0, 4.0, 3.0, 8, 6)
    color, depth = np.zeros((6, 8, 3), np.uint8), np.ones((6, 8), np.float32)
    with pytest.raises(InputError, match=r"depth image: found None; expected a numpy array. Every frame"):
        RgbdFrame(color, None, camera)
    with pytest.raises(InputError, match=r"camera: found ndarray; expected a Camera. Make one: Camera"):
        RgbdFrame(color, depth, np.eye(3))


def test_depth_noise_is_that_of_a_stereo_camera_over_a_floor() -> None:
    f_px, baseline_m, disparity_px = 600.0, 0.05, 0.08
    for z in (0.4, 0.8, 1.6):
        triangulated = f_px * baseline_m / (f_px * baseline_m / z - disparity_px) - z
        assert depth_noise_m(z) - FLOOR_M == pytest.approx(triangulated, rel=0.02)
    assert depth_noise_m(0.0) == FLOOR_M
