"""Where a plane ends: pieces of it in a picture of one depth, with things on it made by hand."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Camera
from huepose.geometry.arrays import Float32
from huepose.perception.planes import Plane, standing_clear

CAMERA = Camera(200.0, 200.0, 99.5, 74.5, 200, 150)
TABLE = Plane(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]))
"""Seen squarely from a metre; a pixel sees 25 square millimetres of it."""


def table() -> Float32:
    return np.ones((150, 200), np.float32)


def test_the_table_is_taken_away_and_a_thing_on_it_stays() -> None:
    depth = table()
    depth[40:80, 60:120] = 0.9
    clear = standing_clear(depth, CAMERA, [TABLE], 0.1)
    assert np.array_equal(clear, depth == np.float32(0.9))


def test_a_plane_that_only_crosses_a_slanted_side_is_not_there() -> None:
    depth = table()
    depth[20:130, 30:170] = np.linspace(0.5, 0.9, 110, dtype=np.float32)[:, None]
    through = Plane(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 0.7]))  # a shelf elsewhere, continued
    clear = standing_clear(depth, CAMERA, [TABLE, through], 0.1)
    assert clear[20:130, 30:170].all()
    assert not clear[:20].any()


def test_the_flat_bottom_of_a_bowl_on_the_table_is_the_bowls() -> None:
    depth = table()
    v, u = np.mgrid[:150, :200]
    away = np.hypot(v - 75.0, u - 100.0)
    depth[away < 50.0] = (1.0 - 0.002 * np.maximum(away - 20.0, 0.0))[away < 50.0]
    clear = standing_clear(depth, CAMERA, [TABLE], 0.1)
    assert clear[away < 48.0].all()


def test_what_is_seen_of_the_table_between_things_is_the_tables() -> None:
    depth = table()
    depth[40:100, 40:160] = 0.8
    depth[60:80, 80:120] = 1.0
    clear = standing_clear(depth, CAMERA, [TABLE], 0.1)
    assert not clear[60:80, 80:120].any()
    assert clear[40:60, 40:160].all()
