"""From a classified cloud to poses: what was moved is found where it went, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.matching.classes import classify
from huepose.matching.cloud import ClassifiedCloud
from huepose.matching.ppf import PpfConfig, build_ppf, ppf_votes
from huepose.matching.triangles import TriangleConfig, build_triangles, triangle_votes
from huepose.matching.types import Votes
from huepose.matching.voting import cluster

DIAMETER_M = 0.156
T_CAM_OBJ = se3.exp(np.array([0.05, -0.03, 0.7, 0.9, -0.6, 1.4]))


def _painted_box(seed: int, count: int = 900, classes: int = 5) -> ClassifiedCloud:
    """Points on a box of 8 x 6 x 12 cm, painted in patches of 2 cm that look alike nowhere."""
    rng = np.random.default_rng(seed)
    half = np.array([0.04, 0.03, 0.06])
    axis, sign = rng.integers(0, 3, count), rng.choice([-1.0, 1.0], count)
    points = rng.uniform(-1, 1, (count, 3)) * half
    points[np.arange(count), axis] = sign * half[axis]
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = sign
    paint = np.random.default_rng(9).integers(0, classes, (8, 8, 8))
    cell = np.floor(points / 0.02).astype(int) + 4
    kinds = paint[cell[:, 0], cell[:, 1], cell[:, 2]].astype(np.uint8)
    f = np.float32
    return ClassifiedCloud(points.astype(f), normals.astype(f), kinds, np.ones(count, f))


def _seen(cloud: ClassifiedCloud, noise_m: float = 0.0005) -> ClassifiedCloud:
    """Another sample's points that face the camera at T_CAM_OBJ."""
    points = se3.apply(T_CAM_OBJ, cloud.points) + np.random.default_rng(3).normal(
        0, noise_m, cloud.points.shape
    )
    normals = cloud.normals @ T_CAM_OBJ[:3, :3].T
    f = np.float32
    moved = ClassifiedCloud(points.astype(f), normals.astype(f), cloud.classes, cloud.weights)
    return moved[(normals * points).sum(1) < -0.2 * np.linalg.norm(points, axis=1)]


def _error(T: np.ndarray) -> tuple[float, float]:
    return float(np.linalg.norm(T[:3, 3] - T_CAM_OBJ[:3, 3])), np.degrees(se3.rotation_angle(T, T_CAM_OBJ))


def _triangle_votes(scene: ClassifiedCloud, model: ClassifiedCloud) -> Votes:
    config = TriangleConfig(candidates=60_000, rows=30_000)
    keys, corners = build_triangles(model, DIAMETER_M, config)
    bin_m = config.bin * DIAMETER_M
    return triangle_votes(scene, model, keys, corners, bin_m, config, np.random.default_rng(0))


def test_triangle_table_is_sorted_and_of_three_classes() -> None:
    model = _painted_box(1)
    keys, corners = build_triangles(model, DIAMETER_M, TriangleConfig(candidates=30_000, rows=5_000))
    assert 0 < len(keys) <= 5_000
    assert (np.diff(keys) >= 0).all()
    classes = model.classes[corners].astype(int)
    assert (np.diff(classes, axis=1) > 0).all()


def test_triangles_find_a_moved_object_among_a_third_of_wrong_classes() -> None:
    model, scene = _painted_box(1), _seen(_painted_box(2))
    wrong = np.random.default_rng(4).random(len(scene)) < 0.33
    classes = np.where(wrong, (scene.classes + 1) % 5, scene.classes).astype(np.uint8)
    scene = ClassifiedCloud(scene.points, scene.normals, classes, scene.weights)
    best = cluster(_triangle_votes(scene, model), np.zeros(3), DIAMETER_M, "pairs")
    translation_m, rotation_deg = _error(best[0].T_cam_obj)
    assert translation_m < 0.01
    assert rotation_deg < 10.0


def test_triangles_say_little_about_another_object() -> None:
    model, scene = _painted_box(1), _seen(_painted_box(2))
    shuffled = np.random.default_rng(5).permutation(scene.classes)
    other = ClassifiedCloud(scene.points, scene.normals, shuffled, scene.weights)
    right = cluster(_triangle_votes(scene, model), np.zeros(3), DIAMETER_M, "pairs")
    wrong = cluster(_triangle_votes(other, model), np.zeros(3), DIAMETER_M, "pairs")
    assert right[0].score > 2.0 * wrong[0].score


def test_without_points_there_are_no_votes() -> None:
    model = _painted_box(1)
    nothing = model[np.zeros(len(model), bool)]
    assert len(_triangle_votes(nothing, model)) == 0
    assert cluster(Votes.empty(), np.zeros(3), DIAMETER_M, "pairs") == []


def test_point_pairs_find_a_moved_object() -> None:
    model, scene = _painted_box(1), _seen(_painted_box(2))
    config = PpfConfig()
    keys, pairs, alpha = build_ppf(model, DIAMETER_M, config)
    assert (np.diff(keys) >= 0).all()
    bin_m = config.bin * DIAMETER_M
    votes = ppf_votes(scene, model, keys, pairs, alpha, bin_m, DIAMETER_M, config, np.random.default_rng(0))
    found = cluster(votes, np.zeros(3), DIAMETER_M, "shape")
    errors = [_error(h.T_cam_obj) for h in found[:3]]
    assert min(t for t, _ in errors) < 0.015
    assert any(t < 0.015 and r < 15.0 for t, r in errors)


def test_point_pairs_can_be_switched_off() -> None:
    keys, pairs, alpha = build_ppf(_painted_box(1), DIAMETER_M, PpfConfig(points=0))
    assert len(keys) == len(pairs) == len(alpha) == 0


@pytest.mark.parametrize("outliers", [200, 2000])
def test_a_planted_cluster_is_found_and_averaged_among_outliers(outliers: int) -> None:
    rng = np.random.default_rng(6)
    near = [se3.perturb(T_CAM_OBJ, rng.normal(0, 1, 6) * ([0.003] * 3 + [0.05] * 3)) for _ in range(80)]
    far = [
        se3.exp(np.r_[rng.uniform([-0.3, -0.3, 0.4], [0.3, 0.3, 1.0]), rng.uniform(-3, 3, 3)])
        for _ in range(outliers)
    ]
    poses = np.array([*near, *far], np.float32)
    count = len(poses)
    votes = Votes(
        poses[:, :3, :3], poses[:, :3, 3], np.ones(count, np.float32), np.arange(count, dtype=np.int32)
    )
    translation_m, rotation_deg = _error(cluster(votes, np.zeros(3), DIAMETER_M, "pairs")[0].T_cam_obj)
    assert translation_m < 0.002
    assert rotation_deg < 2.5


def test_one_feature_that_votes_often_counts_once() -> None:
    loud = se3.exp(np.array([0.0, 0.1, 0.8, 0.0, 2.0, 0.0]))
    poses = np.array([loud] * 500 + [T_CAM_OBJ] * 20, np.float32)
    features = np.r_[np.zeros(500), np.arange(1, 21)].astype(np.int32)
    votes = Votes(poses[:, :3, :3], poses[:, :3, 3], np.ones(520, np.float32), features)
    best = cluster(votes, np.zeros(3), DIAMETER_M, "pairs")[0]
    assert _error(best.T_cam_obj)[0] < 1e-3
    assert best.score == pytest.approx(20.0, rel=0.01)


def test_a_pair_takes_the_classes_of_its_likeness_whichever_side_comes_first() -> None:
    model = np.array([[[30, 40, 20], [80, 0, 0]], [[30, -30, 20], [70, 10, 50]]], np.float32)
    sides = np.array([[0, 2], [1, 3]], np.uint8)
    scene = np.concatenate([model, model[:, ::-1]])
    classes, confidence = classify(scene, model, sides, 4)
    assert classes.tolist() == [[0, 2], [1, 3], [2, 0], [3, 1]]
    assert (confidence > 0.5).all()
