"""A region of depth that no camera measures."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Camera, RgbdFrame
from tests.judge.regions import region_in


def test_at_an_impossibly_small_depth_colours_are_averaged_over_the_whole_mask() -> None:
    camera = Camera(300.0, 300.0, 15.5, 11.5, 32, 24)
    color = np.random.default_rng(0).integers(60, 200, (24, 32, 3), dtype=np.uint8)
    depth = np.full((24, 32), 1e-12, np.float32)
    region = region_in(RgbdFrame(color, depth, camera), np.ones((24, 32), bool), 0.1)
    assert np.ptp(region.colors[1], axis=(0, 1)).max() < 1.0
