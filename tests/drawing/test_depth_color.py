"""Depth as colours."""

from __future__ import annotations

import numpy as np

from huepose.drawing.depth_color import depth_to_color, heat


def test_no_reading_is_black_near_is_blue_far_is_red() -> None:
    depth = np.zeros((10, 30), np.float32)
    depth[:, 10:20], depth[:, 20:] = 0.5, 1.5
    picture = depth_to_color(depth)
    assert not picture[:, :10].any()
    assert picture[0, 15, 2] > picture[0, 15, 0]
    assert picture[0, 25, 0] > picture[0, 25, 2]
    assert not depth_to_color(np.zeros((4, 5), np.float32)).any()


def test_limits_follow_the_data_and_clip() -> None:
    depth = np.linspace(1, 2, 1000, dtype=np.float32).reshape(10, 100)
    picture = depth_to_color(depth)
    assert np.array_equal(picture[0, 0], heat(np.zeros((1, 1)), 0, 1)[0, 0])
    assert np.array_equal(picture[-1, -1], heat(np.ones((1, 1)), 0, 1)[0, 0])
    assert np.array_equal(heat(np.array([[-5.0, 9.0]]), 0, 1), heat(np.array([[0.0, 1.0]]), 0, 1))
