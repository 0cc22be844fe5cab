"""Synthetic classified clouds, and their points that face a camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.model.types import PaperTables
from huepose.paper.cloud import ClassifiedCloud

SeenFrom = Callable[..., ClassifiedCloud]


def on_a_box(each: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """`each` points on every face of a box of 8 x 6 x 12 cm (diameter 15.6 cm), and their normals."""
    half = np.array([0.04, 0.03, 0.06])
    points, normals = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            p = rng.uniform(-1, 1, (each, 3)) * half
            p[:, axis] = sign * half[axis]
            points.append(p)
            normals.append(np.tile(sign * np.eye(3)[axis], (each, 1)))
    return np.concatenate(points), np.concatenate(normals)


@pytest.fixture(scope="session")
def painted() -> ClassifiedCloud:
    """600 points of five classes, in patches of 2 cm."""
    every, normals = on_a_box(100, np.random.default_rng(1))
    cell = np.floor(every / 0.02).astype(int) + 10
    kinds = np.random.default_rng(9).integers(0, 5, (20, 20, 20))[cell[:, 0], cell[:, 1], cell[:, 2]]
    f = np.float32
    ones = np.ones(len(every), f)
    return ClassifiedCloud(every.astype(f), normals.astype(f), kinds.astype(np.uint8), ones)


def bare_tables(cloud: ClassifiedCloud, **filled: object) -> PaperTables:
    """Tables that have only the cloud and the given fields."""
    empty = PaperTables(
        centers=np.zeros((int(cloud.classes.max()) + 1, 3), np.float32),
        side_classes=np.zeros((0, 2), np.uint8),
        cloud_points=cloud.points,
        cloud_normals=cloud.normals,
        cloud_classes=cloud.classes,
        cloud_weights=cloud.weights,
        triangle_keys=np.zeros(0, np.int64),
        triangles=np.zeros((0, 3), np.int32),
        ppf_keys=np.zeros(0, np.int64),
        ppf=np.zeros((0, 2), np.int32),
        ppf_alpha=np.zeros(0, np.float32),
    )
    return replace(empty, **filled)


@pytest.fixture(scope="session")
def seen_from() -> SeenFrom:
    """A function of a cloud, T_cam_obj and `noise`: the points that face the camera, in camera axes."""

    def seen(cloud: ClassifiedCloud, T_cam_obj: np.ndarray, noise: float = 0.0) -> ClassifiedCloud:
        rng = np.random.default_rng(5)
        R, t = T_cam_obj[:3, :3], T_cam_obj[:3, 3]
        points, normals = cloud.points @ R.T + t, cloud.normals @ R.T
        front = (normals * points).sum(1) < -0.2 * np.linalg.norm(points, axis=1)
        points = points + rng.normal(0, noise, points.shape)
        f = np.float32
        return ClassifiedCloud(points.astype(f), normals.astype(f), cloud.classes, cloud.weights)[front]

    return seen
