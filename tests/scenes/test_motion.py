"""Closed paths: smooth also where they close, at the given speeds, without collisions, over the table."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.scenes import motion
from huepose.scenes.camera import CAMERA
from huepose.scenes.motion import (
    FARTHEST_M,
    NEAREST_M,
    TABLE_M,
    UP_ROOM,
    Timing,
    camera_sway,
    object_paths,
    passing,
    positions,
    rotations,
    speeds,
    upright,
)

RADII = np.array([0.09, 0.07, 0.1, 0.09, 0.1])
TIMING = Timing.of(240)


@pytest.fixture(scope="module", params=[0, 1, 2])
def paths(request: pytest.FixtureRequest) -> np.ndarray:
    return object_paths(RADII, CAMERA, TIMING, np.random.default_rng(request.param))


def test_a_spline_of_equal_controls_is_constant_and_of_a_line_has_constant_speed() -> None:
    phase = np.linspace(0, 1, 50, endpoint=False)
    np.testing.assert_allclose(positions(np.ones((6, 3)), phase), 1.0)
    # Far from the wrap, equally spaced controls give an even motion through the middle ones.
    line = positions(np.arange(10.0)[:, None], np.linspace(0.3, 0.6, 7))
    np.testing.assert_allclose(np.diff(line[:, 0]), 0.5, atol=1e-12)
    turns = np.array([se3.rotation_exp(np.array([0, 0, 2 * np.pi * k / 12])) for k in range(12)])
    seen = rotations(turns, np.array([0.0, 0.25, 0.999999, 0.5]))
    assert se3.rotation_angle(seen[0], seen[1]) == pytest.approx(np.pi / 2)
    assert se3.rotation_angle(seen[0], seen[2]) < 1e-4
    assert se3.rotation_angle(seen[0], seen[3]) == pytest.approx(np.pi)


def test_paths_are_smooth_also_where_the_loop_closes(paths: np.ndarray) -> None:
    for track in paths:
        linear, angular = speeds(track)
        assert 0.34 < linear.max() < 0.61
        assert np.radians(60) < angular.max() < np.radians(371)
        # No jump: the speed of the step over the wrap is close to that of its neighbours.
        assert abs(linear[-1] - linear[-2]) < 0.02
        assert abs(angular[-1] - angular[-2]) < 0.15
        assert linear[:20].max() < 0.35 * 0.61


def test_objects_stay_in_view_over_the_table_and_apart(paths: np.ndarray) -> None:
    centres = paths[:, :, :3, 3]
    assert (centres[..., 2] > NEAREST_M).all()
    assert (centres[..., 2] < FARTHEST_M).all()
    assert (centres @ UP_ROOM > RADII[:, None] - TABLE_M).all()
    pixels = CAMERA.project(centres)
    assert (pixels > 15).all()
    assert (pixels < (CAMERA.width - 15, CAMERA.height - 15)).all()
    for i in range(len(RADII)):
        for j in range(i):
            gap = np.linalg.norm(centres[i] - centres[j], axis=1)
            assert gap.min() > RADII[i] + RADII[j]
    assert all(se3.is_rigid(T) for track in paths for T in track[::40])


def test_same_seed_same_paths() -> None:
    a, b = (object_paths(RADII[:2], CAMERA, TIMING, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(a, b)


def test_an_object_that_is_larger_than_the_image_is_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion, "_place", None)
    with pytest.raises(RuntimeError, match="no room"):
        object_paths(np.array([0.09, 0.9]), CAMERA, TIMING, np.random.default_rng(0))


def test_too_many_objects_are_refused() -> None:
    with pytest.raises(RuntimeError, match="no room"):
        object_paths(np.full(12, 0.16), CAMERA, Timing.of(60), np.random.default_rng(0))


def test_the_camera_moves_a_little_and_returns() -> None:
    sway = camera_sway(TIMING, np.random.default_rng(1))
    linear, angular = speeds(sway)
    assert np.abs(sway[:, :3, 3]).max() < 0.03
    assert linear.max() < 0.03
    assert angular.max() < np.radians(3)


def test_the_bar_is_out_of_view_at_first_and_crosses_the_image_twice() -> None:
    bar = passing(TIMING, np.random.default_rng(2), 0.42, 0.36)
    x = CAMERA.project(bar[:, :3, 3])[:, 0]
    inside = (x > 0) & (x < CAMERA.width)
    assert not inside[:45].any()
    assert not inside[-15:].any()
    assert (np.diff(inside.astype(int)) == 1).sum() == 2
    assert speeds(bar)[0].max() < 1.0


def test_upright_puts_the_objects_z_along_the_vertical() -> None:
    np.testing.assert_allclose(upright(1.3)[:, 2], UP_ROOM, atol=1e-12)
    assert np.linalg.det(upright(0.4)) == pytest.approx(1.0)
