"""Parts of path-traced frames that need neither the renderer nor the physics engine."""

from __future__ import annotations

import numpy as np
import pytest

from studies.traced.camera import SWAY_M, WALK_M_S, camera_at, carried, measured, photographed
from studies.traced.light import kelvin
from studies.traced.room import room, surface
from studies.traced.world import HZ


def test_light_is_red_below_and_blue_above_the_daylight_temperature():
    np.testing.assert_allclose(kelvin(6500.0), 1.0)
    warm, cold = kelvin(2800.0), kelvin(9000.0)
    assert warm[0] > 1.3 > 0.6 > warm[2]
    assert cold[0] < 1.0 < cold[2]


def test_the_target_of_a_camera_is_near_the_image_centre():
    target = np.array([0.1, -0.2, 0.05])
    for seed in range(20):
        camera, T_world_cam = camera_at(np.random.default_rng(seed), target)
        at = T_world_cam[:3, :3].T @ (target - T_world_cam[:3, 3])
        assert 0.4 < at[2] < 1.6
        assert (np.abs(camera.project(at[None])[0] - [camera.cx, camera.cy]) < 0.25 * camera.fx).all()


def test_a_carried_camera_walks_around_its_target():
    target = np.array([0.1, -0.2, 0.05])
    for seed in range(10):
        rng = np.random.default_rng(seed)
        camera, T_world_cam = camera_at(rng, target)
        way = carried(rng, target, T_world_cam, 30)
        distances = [np.linalg.norm(T[:3, 3] - target) for T in way]
        assert np.ptp(distances) < 4 * SWAY_M
        away_m = np.linalg.norm(way[-1][:3, 3] - way[0][:3, 3])
        assert away_m < 1.1 * WALK_M_S[1] * 29 / HZ + 2 * SWAY_M
        seen = [camera.project((T[:3, :3].T @ (target - T[:3, 3]))[None])[0] for T in way]
        assert np.linalg.norm(np.ptp(seen, axis=0)) < 0.1 * camera.fx


def test_stereo_depth_has_shadows_and_noise_that_grows_with_the_square_of_depth():
    depth = np.full((240, 320), 2.0, np.float32)
    depth[60:180, 160:240] = 0.5
    rng = np.random.default_rng(1)
    ours = measured(rng, rng, depth, 600.0)
    shadow = ours[80:160, 120:156]
    assert (shadow == 0.0).mean() > 0.3
    near, far = ours[70:170, 170:230], ours[:40]
    spread = [np.std(d[d > 0.0]) for d in (near, far)]
    assert spread[1] == pytest.approx(16.0 * spread[0], rel=0.4)


def test_exposure_compensates_twice_the_light():
    light = np.random.default_rng(0).uniform(0.1, 1.0, (48, 64, 3)).astype(np.float32)
    once, twice = (
        photographed(np.random.default_rng(3), np.random.default_rng(4), k * light) for k in (1.0, 2.0)
    )
    assert np.abs(once.astype(int) - twice).max() <= 1


def test_the_same_seed_gives_the_same_room():
    assert surface(np.random.default_rng(5)).shape == (512, 512, 3)
    first, second = (room(np.random.default_rng(7)) for _ in range(2))
    assert len(first) == len(second) >= 9
    for (mesh, T), (again, S) in zip(first, second, strict=True):
        np.testing.assert_array_equal(T, S)
        np.testing.assert_array_equal(mesh.texture, again.texture)
