"""Classes are the colours of an object; the points of the cloud lie evenly beside the edge."""

from __future__ import annotations

import numpy as np

from huepose.paper.cloud import ClassifiedCloud, color_classes, decoupled, nearest_class, sparse


def test_classes_are_the_planted_colours() -> None:
    rng = np.random.default_rng(0)
    planted = np.array([[20, 0, 0], [50, 60, 30], [60, -40, 40], [90, 0, 5]], np.float32)
    sizes = [800, 300, 100, 60]
    colors = np.concatenate([c + rng.normal(0, 2, (n, 3)) for c, n in zip(planted, sizes, strict=True)])
    centers = color_classes(colors.astype(np.float32), 8)
    for color in planted:
        assert np.linalg.norm(centers - color, axis=1).min() < 3.0
    assert (np.diff(centers[:, 0]) >= 0).all()
    kinds = nearest_class(planted, centers)
    assert len(set(kinds.tolist())) == 4


def test_one_colour_is_one_class() -> None:
    rng = np.random.default_rng(0)
    colors = (np.array([50, 10, 10]) + rng.normal(0, 0.5, (200, 3))).astype(np.float32)
    assert len(color_classes(colors, 8)) == 1


def test_points_of_both_sides_are_beside_the_edge() -> None:
    f = np.float32
    cloud = decoupled(
        np.array([[0, 0, 1]], f),
        np.array([[0, 0, -1]], f),
        np.array([[1, 0, 0]], f),
        np.array([[2, 5]], np.uint8),
        np.array([[0.5, 0.7]], f),
        0.003,
    )
    np.testing.assert_allclose(cloud.points, [[-0.003, 0, 1], [0.003, 0, 1]], atol=1e-7)
    assert cloud.classes.tolist() == [2, 5]
    np.testing.assert_allclose(cloud.weights, [0.5, 0.7])


def test_sparse_keeps_the_point_of_largest_weight_of_each_class() -> None:
    f = np.float32
    points = np.array([[0, 0, 0], [0.001, 0, 0], [0.001, 0, 0], [0.02, 0, 0]], f)
    normals = np.tile(np.array([0, 0, 1], f), (4, 1))
    cloud = ClassifiedCloud(
        points, normals, np.array([0, 0, 1, 0], np.uint8), np.array([0.2, 0.9, 0.5, 0.1], f)
    )
    assert sparse(cloud, 0.005).tolist() == [1, 2, 3]
    back = ClassifiedCloud(points, normals * np.array([[1], [-1], [1], [1]], f), cloud.classes, cloud.weights)
    assert len(sparse(back, 0.005)) == 4  # the other face of a thin wall is kept
