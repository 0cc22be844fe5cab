"""Where a plane ends: in hand-made depth of a table with objects on it."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Camera
from huepose.geometry.arrays import Float32
from huepose.perception.planes import Plane, large_planes, standing_clear

CAMERA = Camera(200.0, 200.0, 99.5, 74.5, 200, 150)
TABLE = Plane(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]))
"""Seen perpendicularly from a metre; a pixel covers 25 square millimetres of it."""


def table() -> Float32:
    return np.ones((150, 200), np.float32)


def test_the_table_is_removed_and_an_object_on_it_stays() -> None:
    depth = table()
    depth[40:80, 60:120] = 0.9
    clear = standing_clear(depth, CAMERA, [TABLE], 0.3)
    assert np.array_equal(clear, depth == np.float32(0.9))


def test_a_plane_that_only_crosses_a_slanted_side_is_not_there() -> None:
    depth = table()
    depth[20:130, 30:170] = np.linspace(0.5, 0.9, 110, dtype=np.float32)[:, None]
    through = Plane(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 0.7]))  # the plane of a shelf elsewhere
    clear = standing_clear(depth, CAMERA, [TABLE, through], 0.3)
    assert clear[20:130, 30:170].all()
    assert not clear[:20].any()


def test_the_flat_bottom_of_a_bowl_on_the_table_belongs_to_the_bowl() -> None:
    depth = table()
    v, u = np.mgrid[:150, :200]
    away = np.hypot(v - 75.0, u - 100.0)
    depth[away < 50.0] = (1.0 - 0.002 * np.maximum(away - 20.0, 0.0))[away < 50.0]
    clear = standing_clear(depth, CAMERA, [TABLE], 0.3)
    assert clear[away < 48.0].all()


def test_the_table_between_objects_belongs_to_the_table() -> None:
    depth = table()
    depth[40:100, 40:160] = 0.8
    depth[60:80, 80:120] = 1.0
    clear = standing_clear(depth, CAMERA, [TABLE], 0.3)
    assert not clear[60:80, 80:120].any()
    assert clear[40:60, 40:160].all()


@pytest.mark.parametrize(
    ("below_m", "rim_m", "stays"),
    [(0.1, 0.1, True), (0.7, 0.7, False), (0.1, -0.05, False)],
    ids=["packages on a table", "a table above the floor", "the ground of a box"],
)
def test_a_large_top_stays_where_depth_falls_a_little_round_it(below_m: float, rim_m: float, stays: bool):
    depth = table() + np.float32(below_m)
    depth[25:125, 30:170] += np.float32(rim_m - below_m)
    depth[30:120, 35:165] = 1.0
    top = depth == np.float32(1.0)
    clear = standing_clear(depth, CAMERA, [TABLE], 0.3)
    assert clear[top].all() if stays else not clear[top].any()


def seen_room(noise: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Depth of a table 0.4 m below the camera, up to 1.2 m away, in front of a wall at 3 m that leans to the
    left; its noise grows with the square of depth. And the table's normal."""
    up = np.array([0.0, -np.cos(0.5), -np.sin(0.5)])
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1)
    table = -0.4 / np.minimum(rays @ up, -1e-6)
    lean = np.array([0.6, 0.0, -0.8])
    wall = -2.4 / (rays @ lean)
    true = np.where(table < 1.2, table, wall)
    return (true + noise * true**2 * rng.normal(size=true.shape)).astype(np.float32), up


def test_a_far_wall_does_not_tilt_the_plane_of_a_table_and_has_its_own_noise():
    depth, up = seen_room(0.004, np.random.default_rng(2))
    planes = large_planes(depth, CAMERA, 0.05)
    assert np.degrees(np.arccos(planes[0].normal @ up)) < 0.3
    # The noise of depth is along the rays, which meet the wall at an angle.
    assert planes[1].noise == pytest.approx(0.004, rel=0.25)
    left = standing_clear(depth, CAMERA, planes, 0.22)
    assert left.mean() < 0.08


def test_a_surface_much_noisier_than_the_quietest_plane_is_no_plane():
    rng = np.random.default_rng(4)
    depth, _ = seen_room(0.001, rng)
    rough = np.zeros(depth.shape, bool)
    rough[:60] = True
    # Rubble is no plane, nor is a wall as rough.
    depth[rough] += rng.uniform(-0.09, 0.09, int(rough.sum())).astype(np.float32)
    planes = large_planes(depth, CAMERA, 0.05)
    assert all(plane.noise < 0.003 for plane in planes)
    assert standing_clear(depth, CAMERA, planes, 0.22)[rough].mean() > 0.8
