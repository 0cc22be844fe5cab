"""Semantic ICP on synthetic classified clouds: it finds the known motion; the classes matter."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.model.types import PaperTables, ReferenceModel
from huepose.paper.cloud import ClassifiedCloud
from huepose.paper.semantic_icp import semantic_icp_many
from huepose.paper.tables import tables_of
from tests.kernels import compiled
from tests.paper.conftest import bare_tables, on_a_box


def semantic_icp(
    reference: PaperTables,
    points_cam: np.ndarray,
    classes: np.ndarray,
    weights: np.ndarray,
    T_cam_obj: np.ndarray,
) -> np.ndarray:
    """Align from one start pose."""
    scene = ClassifiedCloud(points_cam, np.zeros_like(points_cam), classes, weights)
    return semantic_icp_many(reference, scene, T_cam_obj[None])[0]


def bare_reference(points: np.ndarray, normals: np.ndarray, classes: np.ndarray) -> PaperTables:
    """Tables that have only the cloud."""
    f = np.float32
    ones = np.ones(len(points), f)
    return bare_tables(ClassifiedCloud(points.astype(f), normals.astype(f), classes.astype(np.uint8), ones))


@pytest.fixture(scope="module")
def painted_box() -> PaperTables:
    """A box whose faces are painted in patches of five classes."""
    points, normals = on_a_box(500, np.random.default_rng(3))
    patch = np.floor(points / 0.02).astype(int) @ np.array([1, 3, 7])
    return bare_reference(points, normals, patch % 5)


def test_all_levels_share_one_kernel(painted_box: PaperTables) -> None:
    """Compiling a second version would take seconds."""
    ones = np.ones(len(painted_box.cloud_points))
    semantic_icp(painted_box, painted_box.cloud_points, painted_box.cloud_classes, ones, np.eye(4))
    assert compiled()["huepose.paper.semantic_icp._align_all"] == 1


def start_from(T: np.ndarray, degrees: float, metres: float, rng: np.random.Generator) -> np.ndarray:
    turn, shift = rng.normal(size=3), rng.normal(size=3)
    turn *= np.radians(degrees) / np.linalg.norm(turn)
    shift *= metres / np.linalg.norm(shift)
    return se3.perturb(T, np.concatenate([shift, turn]))


def test_ten_degrees_and_one_centimetre_are_corrected(painted_box: PaperTables) -> None:
    rng = np.random.default_rng(0)
    T_true = se3.make(se3.rotation_exp(np.array([0.4, -0.7, 0.3])), np.array([0.02, -0.05, 0.7]))
    front = painted_box.cloud_normals @ T_true[:3, :3].T[:, 2] < -0.2
    scene = se3.apply(T_true, painted_box.cloud_points[front])
    for _ in range(5):
        start = start_from(T_true, 10.0, 0.01, rng)
        result = semantic_icp(
            painted_box, scene, painted_box.cloud_classes[front], np.ones(len(scene)), start
        )
        assert np.degrees(se3.rotation_angle(result, T_true)) < 0.2
        assert np.linalg.norm(result[:3, 3] - T_true[:3, 3]) < 3e-4


def test_noise_and_wrong_classes_are_tolerated(painted_box: PaperTables) -> None:
    rng = np.random.default_rng(1)
    T_true = se3.make(se3.rotation_exp(np.array([-0.3, 0.5, 1.3])), np.array([0.0, 0.0, 0.6]))
    front = painted_box.cloud_normals @ T_true[:3, :3].T[:, 2] < -0.2
    scene = se3.apply(T_true, painted_box.cloud_points[front]) + rng.normal(0, 1e-3, (front.sum(), 3))
    classes = painted_box.cloud_classes[front].copy()
    wrong = rng.random(len(classes)) < 0.2
    classes[wrong] = rng.integers(0, 5, wrong.sum())
    start = start_from(T_true, 6.0, 0.006, rng)
    result = semantic_icp(painted_box, scene, classes, np.ones(len(scene)), start)
    assert np.degrees(se3.rotation_angle(result, T_true)) < 0.7
    assert np.linalg.norm(result[:3, 3] - T_true[:3, 3]) < 1e-3


def test_classes_determine_the_rotation_that_shape_cannot() -> None:
    """A cylinder with stripes: only the classes determine its rotation about the axis."""
    rng = np.random.default_rng(2)
    angle, z = rng.uniform(-np.pi, np.pi, 3000), rng.uniform(-0.06, 0.06, 3000)
    normals = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    points = 0.035 * normals + np.stack([0 * z, 0 * z, z], 1)
    stripes = np.floor((angle + np.pi) / (2 * np.pi) * 9).astype(int) % 3
    can = bare_reference(points, normals, stripes)
    T_true = se3.make(se3.rotation_exp(np.array([1.4, 0.1, 0.0])), np.array([0.0, 0.0, 0.6]))
    front = normals @ T_true[:3, :3].T[:, 2] < -0.2
    scene = se3.apply(T_true, points[front])
    start = T_true @ se3.make(se3.rotation_exp(np.array([0, 0, np.radians(10.0)])), np.zeros(3))
    ones = np.ones(len(scene))
    seen = semantic_icp(can, scene, can.cloud_classes[front], ones, start)
    assert np.degrees(se3.rotation_angle(seen, T_true)) < 0.5
    plain = bare_reference(points, normals, np.zeros(len(points)))
    blind = semantic_icp(plain, scene, np.zeros(len(scene), np.uint8), ones, start)
    assert np.degrees(se3.rotation_angle(blind, T_true)) > 8.0


def test_without_near_points_the_pose_does_not_change(painted_box: PaperTables) -> None:
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.5]))
    far = np.array([[1.0, 1.0, 3.0]] * 20)
    result = semantic_icp(painted_box, far, np.zeros(20, np.uint8), np.ones(20), T)
    np.testing.assert_allclose(result, T)
    empty = semantic_icp(painted_box, np.zeros((0, 3)), np.zeros(0, np.uint8), np.zeros(0), T)
    np.testing.assert_allclose(empty, T)


def test_it_works_on_a_real_reference(tea_box: ReferenceModel) -> None:
    reference = tables_of(tea_box)
    rng = np.random.default_rng(4)
    T_true = se3.make(se3.rotation_exp(np.array([2.0, 0.4, 0.2])), np.array([0.0, 0.05, 0.8]))
    seen = reference.cloud_normals @ T_true[:3, :3].T[:, 2] < -0.3
    scene = se3.apply(T_true, reference.cloud_points[seen])
    result = semantic_icp(
        reference,
        scene,
        reference.cloud_classes[seen],
        reference.cloud_weights[seen],
        start_from(T_true, 5.0, 0.005, rng),
    )
    assert np.degrees(se3.rotation_angle(result, T_true)) < 0.2
    assert np.linalg.norm(result[:3, 3] - T_true[:3, 3]) < 3e-4
