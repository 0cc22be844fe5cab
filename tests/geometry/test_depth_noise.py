"""Depth noise follows from stereo geometry: disparity off by d pixels is depth off by z^2 d / (f B)."""

from __future__ import annotations

import doctest

import pytest

from huepose.geometry import depth_noise
from huepose.geometry.depth_noise import FLOOR_M, depth_noise_m


def test_it_is_that_of_a_stereo_camera_over_a_floor() -> None:
    f_px, baseline_m, disparity_px = 600.0, 0.05, 0.08
    for z in (0.4, 0.8, 1.6):
        triangulated = f_px * baseline_m / (f_px * baseline_m / z - disparity_px) - z
        assert depth_noise_m(z) - FLOOR_M == pytest.approx(triangulated, rel=0.02)
    assert depth_noise_m(0.0) == FLOOR_M
    assert doctest.testmod(depth_noise).failed == 0
