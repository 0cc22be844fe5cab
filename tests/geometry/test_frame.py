"""A frame takes images as cameras and files give them, and refuses invalid ones."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame
from huepose.support.errors import InputError

CAMERA = Camera(300.0, 300.0, 3.5, 2.5, 8, 6)
COLOR = np.zeros((6, 8, 3), np.uint8)


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf])
def test_nan_and_infinite_depth_become_missing_depth(nothing: float) -> None:
    given = np.full((6, 8), 0.7, np.float32)
    given[2, 3:5] = nothing
    given[4, 1] = -nothing
    expected = np.where(np.isfinite(given), given, 0.0)
    kept = given.copy()
    np.testing.assert_array_equal(RgbdFrame(COLOR, given, CAMERA).depth, expected)
    np.testing.assert_array_equal(given, kept)


def test_negative_depth_becomes_missing_depth() -> None:
    given = np.full((6, 8), 0.7, np.float32)
    given[2, 3:5] = -1.0
    expected = np.where(given > 0.0, given, 0.0)
    np.testing.assert_array_equal(RgbdFrame(COLOR, given, CAMERA).depth, expected)


def test_finite_depth_is_taken_as_it_is() -> None:
    given = np.full((6, 8), 0.7, np.float32)
    assert RgbdFrame(COLOR, given, CAMERA).depth is given


def test_depth_of_another_byte_order_is_refused() -> None:
    with pytest.raises(InputError, match=r"found \(6, 8\) >f4; expected \(6, 8\) float32"):
        RgbdFrame(COLOR, np.ones((6, 8), ">f4"), CAMERA)


@pytest.mark.parametrize(("width", "height"), [(1, 6), (8, 1)])
def test_an_image_of_one_row_or_column_is_refused(width: int, height: int) -> None:
    camera = Camera(300.0, 300.0, 0.0, 0.0, width, height)
    with pytest.raises(InputError, match="sides of 2 pixels or more"):
        RgbdFrame(np.zeros((height, width, 3), np.uint8), np.ones((height, width), np.float32), camera)


def test_the_camera_pose_is_a_rigid_transform_or_unknown() -> None:
    depth = np.ones((6, 8), np.float32)
    assert RgbdFrame(COLOR, depth, CAMERA).T_parent_cam is None
    assert (
        RgbdFrame(COLOR, depth, CAMERA, T_parent_cam=np.eye(4)).without(depth > 0.0).T_parent_cam is not None
    )
    far = np.eye(4)
    far[0, 3] = 1e200
    for wrong in (np.eye(3), np.diag([1.0, 1.0, -1.0, 1.0]), np.full((4, 4), np.nan), far):
        with pytest.raises(
            InputError, match=r"T_parent_cam, the camera's pose: found .*expected a rigid transform"
        ):
            RgbdFrame(COLOR, depth, CAMERA, T_parent_cam=wrong)


def test_the_camera_pose_is_kept_though_its_array_is_written_again() -> None:
    T = np.eye(4)
    frame = RgbdFrame(COLOR, np.ones((6, 8), np.float32), CAMERA, T_parent_cam=T)
    T[0, 3] = 1.0
    assert frame.T_parent_cam is not None
    assert frame.T_parent_cam[0, 3] == 0.0


def test_a_timestamp_is_whole_nanoseconds() -> None:
    depth = np.ones((6, 8), np.float32)
    with pytest.raises(InputError, match=r"stamp_ns: found float; expected a whole number. Nanoseconds of a"):
        RgbdFrame(COLOR, depth, CAMERA, stamp_ns=0.033)
    assert type(RgbdFrame(COLOR, depth, CAMERA, np.int64(3), np.int64(7)).stamp_ns) is int
