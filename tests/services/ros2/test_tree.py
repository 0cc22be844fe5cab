"""Transforms through a tree of frames, compared with products of matrices."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import se3
from huepose_protos.messages import Mount
from huepose_protos.motion import inverted, mount_of, quaternion_from, rotation_matrix
from huepose_services.ros2.tree import Tree

MS = 1_000_000
T0 = 1_700_000_000_000_000_000


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return se3.make(se3.rotation_exp(rng.normal(size=3)), rng.normal(size=3))


def mount(parent: str, T: np.ndarray) -> Mount:
    return mount_of(parent, T[:3, 3], quaternion_from(T[:3, :3]))


def matrix(place: Mount) -> np.ndarray:
    return se3.make(rotation_matrix(np.array(place.quaternion)), np.array(place.translation))


def test_an_inverse() -> None:
    T = random_pose(np.random.default_rng(0))
    back = inverted(mount("base", T), "tool")
    assert back.parent == "tool"
    assert np.allclose(matrix(back), np.linalg.inv(T))


def test_a_chain_of_moving_joints_and_static_links() -> None:
    rng = np.random.default_rng(1)
    a, b, c = (random_pose(rng) for _ in range(3))
    tree = Tree("base", "camera")
    tree.take([(T0, "camera", mount("tool", c))], static=True)
    assert not tree.connected
    tree.take([(T0, "link", mount("base", a)), (T0, "tool", mount("link", b))], static=False)
    found = tree.newest(T0 + MS)
    assert found is not None
    assert found[0] == T0
    assert found[1].parent == "base"
    assert np.allclose(matrix(found[1]), a @ b @ c)
    assert tree.newest(T0 + MS) is None, "each timestamp once"


@pytest.mark.parametrize(("parent", "child"), [("arm", "camera"), ("camera", "arm")])
def test_frames_on_two_branches(parent: str, child: str) -> None:
    rng = np.random.default_rng(2)
    T_root_arm, T_root_camera = random_pose(rng), random_pose(rng)
    tree = Tree(parent, child)
    tree.take(
        [(T0, "arm", mount("root", T_root_arm)), (T0, "camera", mount("root", T_root_camera))], static=True
    )
    found = tree.newest(T0 + 5 * MS)
    assert found is not None
    assert found[0] == T0 + 5 * MS, "what is static holds at any time"
    T_arm_camera = np.linalg.inv(T_root_arm) @ T_root_camera
    assert np.allclose(matrix(found[1]), T_arm_camera if parent == "arm" else np.linalg.inv(T_arm_camera))


def test_two_publishers_that_do_not_measure_at_the_same_time() -> None:
    """The last timestamp of the slower one counts; the faster one is interpolated there, exactly for a
    rotation about an axis at constant speed."""

    def rotated(seconds: float) -> np.ndarray:
        return se3.make(se3.rotation_exp(np.array([0.0, 0.0, 2.0 * seconds])), np.array([seconds, 0.0, 0.0]))

    tree = Tree("map", "tool")
    for k in range(4):
        tree.take([(T0 + k * 20 * MS, "tool", mount("base", rotated(k * 0.02)))], static=False)
    tree.take([(T0 + 50 * MS, "base", mount("map", np.eye(4)))], static=False)
    found = tree.newest(T0)
    assert found is not None
    assert found[0] == T0 + 50 * MS
    assert np.allclose(matrix(found[1]), rotated(0.05))


def test_a_late_transform_is_ignored_and_a_clock_that_is_set_back_begins_anew() -> None:
    here, there = mount("base", np.eye(4)), mount("base", se3.make(np.eye(3), np.ones(3)))
    tree = Tree("base", "tool")
    tree.take([(T0, "tool", here)], static=False)
    assert tree.newest(T0) is not None
    tree.take([(T0 - 10 * MS, "tool", there)], static=False)
    assert tree.newest(T0) is None
    tree.take([(T0 - 5000 * MS, "tool", there)], static=False)
    found = tree.newest(T0)
    assert found is not None
    assert found == (T0 - 5000 * MS, there)


def test_static_transforms_are_known_after_the_wall_clock_was_set_back() -> None:
    tree = Tree("base", "tool")
    tree.take([(0, "tool", mount("base", np.eye(4)))], static=True)
    for now_ns in (T0, T0 + 1000 * MS, T0 - 3_600_000 * MS):
        found = tree.newest(now_ns)
        assert found is not None
        assert found[0] == now_ns


def test_a_cycle_of_frames_does_not_loop_for_ever() -> None:
    tree = Tree("base", "a")
    place = mount("b", np.eye(4))
    tree.take([(T0, "a", place), (T0, "b", mount("a", np.eye(4)))], static=True)
    assert not tree.connected
    assert tree.newest(T0) is None
    assert tree.frames == ("a", "b")
