"""Point pair features: identity, known motion, noise, and few votes for a wrong scene."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.model.types import PaperTables
from huepose.paper.cloud import ClassifiedCloud
from huepose.paper.ppf import BIN, build_ppf, onto_x, ppf_votes
from huepose.paper.voting import cluster
from tests.paper.conftest import bare_tables

DIAMETER = 0.156
T = se3.make(se3.rotation_exp(np.array([-0.5, 0.9, 0.4])), np.array([-0.02, 0.04, 0.7]))


def with_pairs(cloud: ClassifiedCloud) -> PaperTables:
    keys, pairs, alpha = build_ppf(cloud, DIAMETER)
    bin_m = {"ppf_bin_m": BIN * DIAMETER}
    return bare_tables(cloud, ppf_keys=keys, ppf=pairs, ppf_alpha=alpha, parameters=bin_m)


@pytest.fixture(scope="module")
def tables(painted: ClassifiedCloud) -> PaperTables:
    return with_pairs(painted)


def found(scene: ClassifiedCloud, tables: PaperTables) -> tuple[np.ndarray, np.ndarray]:
    votes = ppf_votes(scene, tables, DIAMETER, np.random.default_rng(0))
    return cluster(votes, np.zeros(3), DIAMETER)


def test_frames_rotate_normals_to_x() -> None:
    rng = np.random.default_rng(0)
    for n in [*rng.normal(size=(20, 3)), np.array([-1.0, 0, 0]), np.array([1.0, 0, 0])]:
        n = n / np.linalg.norm(n)
        R = np.empty((3, 3))
        onto_x(*n.tolist(), R)
        np.testing.assert_allclose(R @ n, [1, 0, 0], atol=1e-9)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1.0)


def test_the_model_itself_has_the_identity_pose(painted: ClassifiedCloud, tables: PaperTables) -> None:
    best = found(painted, tables)[0][0]
    assert np.degrees(se3.rotation_angle(best, np.eye(4))) < 4.0
    assert np.linalg.norm(best[:3, 3]) < 0.005


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.002])
def test_a_known_motion_is_found_with_noise(
    painted: ClassifiedCloud, tables: PaperTables, seen_from: Callable[..., ClassifiedCloud], noise: float
) -> None:
    best = found(seen_from(painted, T, noise), tables)[0][0]
    assert np.degrees(se3.rotation_angle(best, T)) < 6.0
    assert np.linalg.norm(best[:3, 3] - T[:3, 3]) < 0.008


def test_two_classes_are_enough(painted: ClassifiedCloud, seen_from: Callable[..., ClassifiedCloud]) -> None:
    merged = ClassifiedCloud(
        painted.points, painted.normals, (painted.classes % 2).astype(np.uint8), painted.weights
    )
    best = found(seen_from(merged, T), with_pairs(merged))[0][0]
    assert np.degrees(se3.rotation_angle(best, T)) < 8.0


def test_a_wrong_scene_gets_few_votes(
    painted: ClassifiedCloud, tables: PaperTables, seen_from: Callable[..., ClassifiedCloud]
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
    (_, right), (_, wrong) = found(scene, tables), found(scrambled, tables)
    assert wrong.max(initial=0.0) < 0.35 * right[0]


def test_one_plane_of_one_class_has_no_point_pairs(painted: ClassifiedCloud) -> None:
    top = painted[painted.normals[:, 2] > 0.5]
    even = ClassifiedCloud(top.points, top.normals, np.zeros(len(top), np.uint8), top.weights)
    assert len(build_ppf(even, DIAMETER)[0]) == 0
