"""Depth with a grid of holes is filled; any other depth is unchanged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame
from huepose.perception.filled import filled

CAMERA = Camera(300.0, 300.0, 79.5, 59.5, 160, 120)


@pytest.fixture
def frame() -> RgbdFrame:
    """A near square in front of a wall, and a region without depth."""
    depth = np.full((120, 160), 1.0, np.float32)
    depth[40:80, 50:90] = 0.6
    depth[20:100, 110:130] = 0.0
    return RgbdFrame(np.full((120, 160, 3), 90, np.uint8), depth, CAMERA)


def test_a_frame_without_a_grid_of_holes_is_the_same(frame: RgbdFrame) -> None:
    assert filled(frame) is frame
    specks = np.random.default_rng(0).random(frame.depth.shape) < 0.05
    assert filled(holed := frame.without(specks)) is holed
    assert filled(empty := replace(frame, depth=np.zeros_like(frame.depth))) is empty


@pytest.mark.parametrize("rows", [1, 2, 3])
@pytest.mark.parametrize("columns", [1, 2, 3])
@pytest.mark.parametrize("first", [0, 1])
def test_holes_are_filled_with_the_nearest_depth_beside_them(
    frame: RgbdFrame, rows: int, columns: int, first: int
) -> None:
    if rows == columns == 1:
        return
    sparse = np.zeros_like(frame.depth)
    sparse[first::rows, first::columns] = frame.depth[first::rows, first::columns]
    found = filled(replace(frame, depth=sparse)).depth
    inside = np.zeros_like(frame.depth, bool)
    inside[44:76, 54:86] = True
    assert (found[inside] == np.float32(0.6)).all()
    np.testing.assert_array_equal(found[sparse > 0], sparse[sparse > 0])
    assert not found[24:96, 114:126].any()
