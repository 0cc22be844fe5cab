"""Surface ICP: an exact transform is recovered, outliers do not matter, and the information is right."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from huepose.geometry import se3
from huepose.model.types import DistanceGrid, Surface
from huepose.refine.point_to_plane import align, align_many

SIZE = np.array([0.10, 0.07, 0.16])
CENTRE = np.array([0.02, -0.01, 0.03])  # the mesh's origin need not be its middle


def box_surface(spacing: float = 0.004) -> tuple[Surface, DistanceGrid]:
    points, normals = [], []
    for axis in range(3):
        a, b = [k for k in range(3) if k != axis]
        u = np.arange(-SIZE[a] / 2 + spacing / 2, SIZE[a] / 2, spacing)
        v = np.arange(-SIZE[b] / 2 + spacing / 2, SIZE[b] / 2, spacing)
        for sign in (-1.0, 1.0):
            face = np.zeros((len(u) * len(v), 3))
            face[:, a], face[:, b] = (g.ravel() for g in np.meshgrid(u, v))
            face[:, axis] = sign * SIZE[axis] / 2
            points.append(face + CENTRE)
            normals.append(np.tile(np.eye(3)[axis] * sign, (len(face), 1)))
    p, n = np.concatenate(points), np.concatenate(normals)
    origin, step = p.min(0) - 0.03, 0.002
    shape = np.ceil((p.max(0) + 0.03 - origin) / step).astype(int) + 1
    cells = np.stack(np.meshgrid(*[np.arange(k) for k in shape], indexing="ij"), -1) * step + origin
    nearest = cKDTree(p).query(cells.reshape(-1, 3))[1].astype(np.int16).reshape(shape)
    nothing = np.zeros(0, np.int32)
    surface = Surface(
        p.astype(np.float32),
        n.astype(np.float32),
        np.zeros((2, len(p), 3), np.float32),
        np.zeros((0, 3), np.float32),
        nothing,
        nothing,
    )
    return surface, DistanceGrid(origin, step, nearest)


@pytest.fixture(scope="module")
def model() -> tuple[Surface, DistanceGrid]:
    return box_surface()


TRUE_POSE = se3.make(se3.rotation_exp(np.array([0.5, -0.7, 0.3])), np.array([0.05, -0.02, 0.7]))


def visible_points(T: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Exact points of the box's faces that face the camera, camera axes."""
    axis = rng.integers(0, 3, count)
    p = rng.uniform(-0.5, 0.5, (count, 3)) * SIZE
    eye = se3.inverse(T)[:3, 3] - CENTRE
    p[np.arange(count), axis] = np.sign(eye[axis]) * SIZE[axis] / 2
    return se3.apply(T, p + CENTRE)


def errors(T: np.ndarray) -> tuple[float, float]:
    """Distance of the box's middle in metres, rotation in degrees."""
    middle = se3.apply(T, CENTRE) - se3.apply(TRUE_POSE, CENTRE)
    return float(np.linalg.norm(middle)), float(np.degrees(se3.rotation_angle(T, TRUE_POSE)))


def test_recovers_a_known_transform(model: tuple[Surface, DistanceGrid]) -> None:
    rng = np.random.default_rng(3)
    points = visible_points(TRUE_POSE, 600, rng)
    for _ in range(10):
        direction = rng.normal(size=6)
        direction[:3] *= 0.012 / np.linalg.norm(direction[:3])
        direction[3:] *= np.radians(10.0) / np.linalg.norm(direction[3:])
        result = align(*model, points, se3.perturb(TRUE_POSE, direction), 0.03, 0.005, 40)
        shift, turn = errors(result.T_cam_obj)
        assert shift < 1e-4
        assert turn < 0.05
        assert result.inliers > 570
        assert result.rms_m < 1e-4


def test_outliers_and_noise_are_tolerated(model: tuple[Surface, DistanceGrid]) -> None:
    rng = np.random.default_rng(4)
    points = visible_points(TRUE_POSE, 600, rng)
    points += rng.normal(0, 0.001, points.shape)
    clutter = points[:200] + rng.uniform(0.015, 0.08, (200, 3))
    start = se3.perturb(TRUE_POSE, np.array([0.006, -0.004, 0.005, 0.06, -0.05, 0.04]))
    result = align(*model, np.concatenate([points, clutter]), start, 0.03, 0.006, 30)
    shift, turn = errors(result.T_cam_obj)
    assert shift < 5e-4
    assert turn < 0.4
    assert 0.0006 < result.rms_m < 0.0014


def test_information_predicts_the_spread(model: tuple[Surface, DistanceGrid]) -> None:
    """Over many draws of noise the squared error in units of the covariance averages its six dimensions."""
    rng = np.random.default_rng(5)
    sigma = 0.0008
    squares = []
    for _ in range(150):
        points = visible_points(TRUE_POSE, 400, rng)
        in_object = np.abs(se3.apply(se3.inverse(TRUE_POSE), points) - CENTRE) / SIZE
        normals = TRUE_POSE[:3, :3].T[np.argmax(in_object, axis=1)]
        points = points + normals * rng.normal(0, sigma, (len(points), 1))
        # Next to an edge the nearest sample may lie on the other face: another source of error.
        points = points[np.sort(in_object, axis=1)[:, 1] < 0.46]
        result = align(*model, points, TRUE_POSE, 0.02, 0.02, 20)
        delta = se3.difference(TRUE_POSE, result.T_cam_obj)
        squares.append(delta @ result.information @ delta / sigma**2)
    assert 5.0 < float(np.mean(squares)) < 7.0


def test_a_face_on_view_leaves_the_slide_alone(model: tuple[Surface, DistanceGrid]) -> None:
    """A plane does not constrain a slide along it: damping keeps it, and the information is almost zero."""
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
    rng = np.random.default_rng(6)
    p = rng.uniform(-0.25, 0.25, (400, 3)) * SIZE
    p[:, 2] = -SIZE[2] / 2
    start = se3.perturb(T, np.array([0.004, -0.003, 0.004, 0.03, 0.02, 0.0]))
    result = align(*model, se3.apply(T, p + CENTRE), start, 0.02, 0.005, 30)
    moved = se3.apply(result.T_cam_obj, CENTRE) - se3.apply(start, CENTRE)
    assert abs(se3.apply(result.T_cam_obj, CENTRE)[2] - se3.apply(T, CENTRE)[2]) < 3e-4
    assert np.linalg.norm(moved[:2]) < 3e-3
    assert result.information[0, 0] < 1e-3 * result.information[2, 2]


def test_points_behind_the_object_are_refused(model: tuple[Surface, DistanceGrid]) -> None:
    """Depth on the far side of the object cannot be its surface."""
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
    rng = np.random.default_rng(7)
    p = rng.uniform(-0.5, 0.5, (200, 3)) * SIZE
    p[:, 2] = SIZE[2] / 2
    result = align(*model, se3.apply(T, p + CENTRE), T, 0.01, 0.01, 5)
    assert result.inliers == 0
    assert np.array_equal(result.T_cam_obj, se3.orthonormalised(T))


def test_no_points_leave_the_pose(model: tuple[Surface, DistanceGrid]) -> None:
    for points in (np.zeros((0, 3)), np.full((50, 3), 9.0)):
        result = align(*model, points, TRUE_POSE, 0.02, 0.005, 10)
        assert np.allclose(result.T_cam_obj, TRUE_POSE, atol=1e-12)
        assert (result.inliers, result.weight, result.rms_m) == (0, 0.0, 0.0)
        assert not result.information.any()


def test_many_poses_at_once_equal_one_by_one(model: tuple[Surface, DistanceGrid]) -> None:
    rng = np.random.default_rng(8)
    points = visible_points(TRUE_POSE, 300, rng)
    starts = np.array([se3.perturb(TRUE_POSE, rng.normal(0, 0.01, 6)) for _ in range(5)])
    together = align_many(*model, points, starts, 0.03, 0.006, 20)
    for start, T in zip(starts, together, strict=True):
        assert np.allclose(align(*model, points, start, 0.03, 0.006, 20).T_cam_obj, T, atol=1e-12)


def test_information_and_error_are_those_of_the_plain_formula(model: tuple[Surface, DistanceGrid]) -> None:
    surface, grid = model
    points = visible_points(TRUE_POSE, 333, np.random.default_rng(8))  # no multiple of anything
    points[:40] += [0.0, 0.0, 0.5]  # outliers
    T, gate = se3.perturb(TRUE_POSE, np.array([0.002, -0.001, 0.001, 0.01, 0.02, -0.01])), 0.008
    fit = align(surface, grid, points, T, gate, gate, 0)
    here = se3.apply(se3.inverse(T), points)
    cell = np.clip(((here - grid.origin) / grid.step + 0.5).astype(int), 0, np.array(grid.nearest.shape) - 1)
    index = grid.nearest[tuple(cell.T)]
    offset, normals = here - surface.points[index], surface.normals[index] @ T[:3, :3].T
    share = (offset**2).sum(1) / gate**2
    weight = np.where((share < 1.0) & ((normals * points).sum(1) <= 0.0), (1.0 - share) ** 2, 0.0)
    distance = (offset * surface.normals[index]).sum(1)
    # How a distance changes when the object is shifted, and rotated about its origin, in camera axes.
    J = -np.concatenate([normals, np.cross(points - T[:3, 3], normals)], axis=1)
    assert fit.inliers == (weight > 0).sum()
    np.testing.assert_allclose(fit.weight, weight.sum(), rtol=1e-6)
    np.testing.assert_allclose(fit.rms_m, np.sqrt((weight * distance**2).sum() / weight.sum()), rtol=1e-5)
    np.testing.assert_allclose(fit.information, J.T @ (J * weight[:, None]), rtol=1e-4, atol=1e-4)
