"""Light: Lambert's law, shadows where they must fall, and smoothness in time."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Camera, se3
from huepose.rendering import render
from huepose.scenes.light import Light, lights, shadow_map, shine
from huepose.scenes.motion import UP_ROOM, Timing
from huepose.scenes.room import sheet

CAMERA = Camera(300.0, 300.0, 159.5, 119.5, 320, 240)
WHITE = np.full((4, 4, 3), 255, np.uint8)


def lit(scene: list, light: Light, gloss: int = 0) -> np.ndarray:
    seen = render(scene, CAMERA)
    total = np.zeros((240, 320, 3), np.float32)
    glossy = np.full((240, 320), gloss, np.uint8)
    shine(
        seen.color,
        seen.normals_cam,
        seen.depth,
        glossy,
        CAMERA,
        np.eye(4),
        light,
        shadow_map(scene, light),
        total,
    )
    return total


def facing_camera(depth_m: float, size_m: float) -> tuple:
    turn = se3.rotation_exp(np.array([np.pi, 0, 0]))  # the texture of a sheet is visible from its +z side
    return sheet(size_m, size_m, WHITE), se3.make(turn, np.array([0, 0, depth_m]))


@pytest.mark.parametrize("angle_deg", [0, 40, 70])
def test_lambert(angle_deg: float) -> None:
    a = np.radians(angle_deg)
    light = Light(np.array([np.sin(a), 0, -np.cos(a)]), 0.8, 0.0, np.array([1.0, 0.9, 0.5]))
    total = lit([facing_camera(1.0, 0.5)], light)
    np.testing.assert_allclose(total[120, 160], 0.8 * np.cos(a) * light.gain, rtol=1e-4)


def test_skylight_depends_on_the_angle_to_the_vertical() -> None:
    total = lit([facing_camera(1.0, 0.5)], Light(UP_ROOM, 0.0, 0.5, np.ones(3)))
    np.testing.assert_allclose(total[120, 160], 0.5 * (0.65 + 0.35 * -UP_ROOM[2]), rtol=1e-4)


def test_shadow_falls_opposite_the_light() -> None:
    a = np.radians(30)
    light = Light(np.array([np.sin(a), 0, -np.cos(a)]), 1.0, 0.0, np.ones(3))  # from the right
    total = lit([facing_camera(1.0, 1.2), facing_camera(0.8, 0.1)], light)
    # The small square, 0.2 m before the wall, throws a shadow 0.2 tan 30 = 0.115 m to the left.
    column = round(CAMERA.cx - 0.115 * 300)
    assert total[119, column].max() < 0.01
    assert total[119, round(CAMERA.cx + 0.115 * 300)].min() > 0.8
    assert total[119, 159].min() > 0.8  # the square itself
    shaded = (total[..., 0] < 0.01).sum()
    hidden_by_square = 0.5 * (0.1 * 300) ** 2
    assert 0.6 * (0.1 * 300) ** 2 < shaded < (0.1 * 300) ** 2 + hidden_by_square


def test_highlights_only_on_glossy_objects() -> None:
    light = Light(np.array([0, 0, -1.0]), 0.5, 0.0, np.ones(3), gloss=0.2)
    scene = [facing_camera(1.0, 0.5)]
    assert lit(scene, light, 1)[119, 159, 0] == pytest.approx(0.7, abs=0.01)
    assert lit(scene, light, 0)[119, 159, 0] == pytest.approx(0.5, abs=0.01)


def test_light_changes_smoothly_also_where_the_loop_closes() -> None:
    row = lights(Timing.of(240), np.random.default_rng(0))
    gains = np.array([light.gain for light in row])
    directions = np.array([light.towards_room for light in row])
    assert np.abs(gains - np.roll(gains, 1, 0)).max() < 0.06
    assert np.abs(directions - np.roll(directions, 1, 0)).max() < 0.06
    assert np.ptp(gains[:, 0]) > 0.1
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1.0)
    assert (directions @ UP_ROOM > 0.3).all()
