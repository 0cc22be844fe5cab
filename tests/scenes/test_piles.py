from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Camera, se3
from huepose.rendering import render_depth
from huepose.scenes.heap import open_box
from huepose.scenes.rendered import PILES, rendered_frame
from huepose.scenes.sensor import LOST_SHARE, lost_in_bad_light, shifted
from tests.meshes import demo_objects

MESHES = {name: mesh for name, mesh in demo_objects(3).items() if name in ("tea_box", "soup_can")}


def test_an_open_box_is_a_floor_with_walls_around() -> None:
    box = open_box(0.15, 0.1, np.random.default_rng(0))
    low, high = box.vertices.min(0), box.vertices.max(0)
    assert high[1] == pytest.approx(0.158)
    assert 0.158 <= high[0] <= 0.188
    np.testing.assert_allclose([low[2], high[2]], [-0.05, 0.05], atol=1e-6)
    camera = Camera(500.0, 500.0, 100.0, 100.0, 201, 201)
    from_above = se3.make(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    depth = render_depth(box, from_above, camera)
    assert depth[100, 100] == pytest.approx(1.042, abs=1e-4)  # the floor
    wall = 100 + round(500.0 * 0.154 / 0.95)
    assert depth[wall, 100] == pytest.approx(0.95, abs=1e-4)  # the rim


def test_depth_is_lost_in_the_dark_and_in_glare_only() -> None:
    depth = np.ones((200, 300), np.float32)
    color = np.full((200, 300, 3), 120, np.uint8)
    color[:, :100], color[:, 200:] = 4, 255
    left = lost_in_bad_light(depth, color, np.random.default_rng(1)) > 0
    assert left[:, 110:190].all()
    for bad in (left[:, :90], left[:, 210:]):
        assert 1.0 - bad.mean() == pytest.approx(LOST_SHARE, abs=0.1)


def test_depth_is_shifted_against_colour() -> None:
    depth = np.arange(1.0, 13.0, dtype=np.float32).reshape(3, 4)
    moved = shifted(depth, 1, -1)
    assert moved.tolist() == [[0.0, 5.0, 6.0, 7.0], [0.0, 9.0, 10.0, 11.0], [0.0, 0.0, 0.0, 0.0]]


def test_labels_of_a_pile_agree_with_depth_and_it_is_deterministic() -> None:
    ranges = replace(PILES, others=(1, 1), exposure=(0.0, 0.0))
    numbers = [k for k in range(4) if np.random.default_rng([5, k, 63]).random() < 0.5]
    drawn = rendered_frame(MESHES, 5, numbers[0], ranges)
    again = rendered_frame(MESHES, 5, numbers[0], ranges)
    np.testing.assert_array_equal(drawn.shot.color, again.shot.color)
    np.testing.assert_array_equal(drawn.shot.depth, again.shot.depth)
    plain = rendered_frame(MESHES, 5, numbers[0], replace(ranges, pile=False))
    assert drawn.shot.owner.max() > plain.shot.owner.max()  # the open box around has the last number
    for k, name in enumerate(drawn.names):
        seen = (drawn.shot.owner == k) & (drawn.shot.depth > 0)
        true = render_depth(MESHES[name], drawn.shot.labels.T_cam_obj[k], drawn.camera)
        assert seen.sum() > 100
        assert np.median(np.abs(drawn.shot.depth[seen] - true[seen])) < 0.01
