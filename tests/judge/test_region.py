"""What a region makes of readings that no camera gives."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Camera, RgbdFrame
from tests.judge.regions import region_in


def test_what_is_as_near_as_nothing_can_be_has_the_colours_of_all_that_is_seen() -> None:
    camera = Camera(300.0, 300.0, 15.5, 11.5, 32, 24)
    color = np.random.default_rng(0).integers(60, 200, (24, 32, 3), dtype=np.uint8)
    depth = np.full((24, 32), 1e-12, np.float32)
    region = region_in(RgbdFrame(color, depth, camera), np.ones((24, 32), bool), 0.1)
    assert np.ptp(region.colors[1], axis=(0, 1)).max() < 1.0
