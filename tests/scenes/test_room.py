"""The room: clutter on the table behind the objects; textures have detail."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.rendering import render
from huepose.scenes.camera import CAMERA
from huepose.scenes.motion import FARTHEST_M, TABLE_M, UP_ROOM
from huepose.scenes.room import ball, bar, clutter, room


def test_clutter_stands_on_the_table_behind_the_objects() -> None:
    placed = room(np.random.default_rng(0))
    assert len(placed) == 13
    for mesh, T in placed[2:]:
        heights = se3.apply(T, mesh.vertices) @ UP_ROOM
        np.testing.assert_allclose(heights.min(), -TABLE_M, atol=1e-6)
        assert heights.max() < -TABLE_M + 0.16
        assert np.linalg.norm(T[:3, 3]) > FARTHEST_M


def test_the_room_fills_the_image_and_is_seen_from_the_right_side() -> None:
    placed = room(np.random.default_rng(1))
    seen = render(placed, CAMERA)
    assert (seen.depth > 0).mean() > 0.999
    table = seen.object_index == 0
    assert table.mean() > 0.3
    np.testing.assert_allclose(seen.normals_cam[table].astype(float).mean(0), UP_ROOM, atol=1e-5)
    assert (seen.object_index == 1).sum() > 5000
    assert seen.color[table].astype(float).std() > 15


def test_clutter_is_small_and_depends_on_the_seed() -> None:
    for seed in range(12):
        mesh, again = (clutter(np.random.default_rng(seed)) for _ in range(2))
        assert 0.04 < np.ptp(mesh.vertices, 0).max() < 0.17
        assert np.array_equal(mesh.texture, again.texture)
    assert np.ptp(bar(np.random.default_rng(0)).vertices, 0)[1] > 0.59
    corners = np.concatenate([chart.corners for chart in ball(0.05)])
    np.testing.assert_allclose(np.linalg.norm(corners.reshape(-1, 3), axis=1), 0.05, atol=1e-9)
