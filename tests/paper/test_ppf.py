"""Point pair features: identity, known motion, noise, and a wrong scene that is turned down."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.paper.cloud import ClassifiedCloud
from huepose.paper.ppf import BIN, build_ppf, onto_x, ppf_votes
from huepose.paper.voting import cluster
from huepose.propose.types import Hypothesis

DIAMETER = 0.156
T = se3.make(se3.rotation_exp(np.array([-0.5, 0.9, 0.4])), np.array([-0.02, 0.04, 0.7]))

Table = tuple[np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def table(painted: ClassifiedCloud) -> Table:
    return build_ppf(painted, DIAMETER)


def found(scene: ClassifiedCloud, model: ClassifiedCloud, table: Table) -> list[Hypothesis]:
    rng = np.random.default_rng(0)
    votes = ppf_votes(scene, model, *table, BIN * DIAMETER, DIAMETER, rng)
    return cluster(votes, np.zeros(3), DIAMETER, "ppf")


def test_frames_take_normals_to_x() -> None:
    rng = np.random.default_rng(0)
    for n in [*rng.normal(size=(20, 3)), np.array([-1.0, 0, 0]), np.array([1.0, 0, 0])]:
        n = n / np.linalg.norm(n)
        R = np.empty((3, 3))
        onto_x(*n.tolist(), R)
        np.testing.assert_allclose(R @ n, [1, 0, 0], atol=1e-9)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1.0)


def test_identity(painted: ClassifiedCloud, table: Table) -> None:
    best = found(painted, painted, table)[0].T_cam_obj
    assert np.degrees(se3.rotation_angle(best, np.eye(4))) < 4.0
    assert np.linalg.norm(best[:3, 3]) < 0.005


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.002])
def test_a_known_motion_with_noise(
    painted: ClassifiedCloud, table: Table, seen_from: Callable[..., ClassifiedCloud], noise: float
) -> None:
    best = found(seen_from(painted, T, noise), painted, table)[0].T_cam_obj
    assert np.degrees(se3.rotation_angle(best, T)) < 6.0
    assert np.linalg.norm(best[:3, 3] - T[:3, 3]) < 0.008


def test_two_classes_are_enough(painted: ClassifiedCloud, seen_from: Callable[..., ClassifiedCloud]) -> None:
    merged = ClassifiedCloud(
        painted.points, painted.normals, (painted.classes % 2).astype(np.uint8), painted.weights
    )
    best = found(seen_from(merged, T), merged, build_ppf(merged, DIAMETER))[0].T_cam_obj
    assert np.degrees(se3.rotation_angle(best, T)) < 8.0


def test_a_wrong_scene_gets_few_votes(
    painted: ClassifiedCloud, table: Table, seen_from: Callable[..., ClassifiedCloud]
) -> None:
    scene = seen_from(painted, T)
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(len(scene), 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    scrambled = ClassifiedCloud(
        (rng.uniform(-0.06, 0.06, (len(scene), 3)) + np.array([0, 0, 0.7])).astype(np.float32),
        normals.astype(np.float32),
        scene.classes,
        scene.weights,
    )
    right, wrong = found(scene, painted, table), found(scrambled, painted, table)
    assert not wrong or wrong[0].score < 0.35 * right[0].score


def test_one_plane_of_one_class_tells_nothing(painted: ClassifiedCloud) -> None:
    top = painted[painted.normals[:, 2] > 0.5]
    even = ClassifiedCloud(top.points, top.normals, np.zeros(len(top), np.uint8), top.weights)
    assert len(build_ppf(even, DIAMETER)[0]) == 0
