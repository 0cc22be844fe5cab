"""Find near-symmetries: rotations that map a shape nearly onto itself, so that depth alone cannot separate
the poses.

Rotations spread over SO(3) are refined by ICP of the surface onto itself; those with a small remaining error
are near-symmetries. `SidedSurface` searches position and scaled normal together, so that the two sides of a
thin wall are far apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64, Int64
from huepose.geometry.suppression import first_different
from huepose.geometry.symmetry import rotation_about
from huepose.model.types import DistanceGrid, Surface
from huepose.refine.point_to_plane import SurfaceArrays, surface_arrays
from huepose.support.jit import jit

_NORMAL_LENGTH = 0.05  # of the diameter: opposite normals count as a tenth of a diameter


@dataclass(frozen=True, eq=False)
class SidedSurface:
    """points, normals (N, 3) of a surface, searched by both at once; diameter_m of the object."""

    points: Float64
    normals: Float64
    diameter_m: float
    tree: Any

    @staticmethod
    def of(points: Float, normals: Float, diameter_m: float) -> SidedSurface:
        """Build the search tree."""
        from scipy.spatial import cKDTree

        p, n = np.asarray(points, np.float64), np.asarray(normals, np.float64)
        return SidedSurface(p, n, diameter_m, cKDTree(np.hstack([p, _NORMAL_LENGTH * diameter_m * n])))

    def nearest(self, points: Float, normals: Float) -> Int64:
        """Indices (M,) of the samples nearest to oriented points (M, 3)."""
        query = np.hstack([points, _NORMAL_LENGTH * self.diameter_m * np.asarray(normals)])
        return np.asarray(self.tree.query(query)[1], np.int64)

    def offsets(self, rotation: Float, points: Float, normals: Float) -> tuple[Float64, Float64]:
        """Distances of transformed points (M, 3) with normals from the surface, over the diameter: to the
        tangent plane of the nearest sample (M,) and to the sample itself (M,). They are at least 0.05 if
        the normals differ by more than 60 degrees."""
        moved, rotated = se3.apply(rotation, points), normals @ rotation[:3, :3].T
        j = self.nearest(moved, rotated)
        gap = moved - self.points[j]
        elsewhere = np.einsum("md,md->m", self.normals[j], rotated) < 0.5
        plane = np.abs(np.einsum("md,md->m", gap, self.normals[j])) / self.diameter_m
        distance = np.linalg.norm(gap, axis=1) / self.diameter_m
        return np.maximum(plane, 0.05 * elsewhere), np.maximum(distance, 0.05 * elsewhere)

    def polished(self, rotation: Float64, points: Float, normals: Float) -> Float64:
        """Refine a transform (4, 4) by eight point-to-plane steps of the transformed points onto the
        surface."""
        T = rotation
        for _ in range(8):
            moved, rotated = se3.apply(T, points), normals @ T[:3, :3].T
            j = self.nearest(moved, rotated)
            n = self.normals[j]
            gap = moved - self.points[j]
            residual = np.einsum("md,md->m", gap, n)
            weight = 1.0 / (1.0 + (np.linalg.norm(gap, axis=1) / (0.02 * self.diameter_m)) ** 2)
            weight *= np.maximum(np.einsum("md,md->m", n, rotated), 0.0)
            lever = moved - moved.mean(0)
            J = np.hstack([n, np.cross(lever, n)])
            damping = np.diag([1e-3] * 3 + [1e-3 * self.diameter_m**2 / 12] * 3) * weight.sum()
            step = np.linalg.solve((J * weight[:, None]).T @ J + damping, -(J * weight[:, None]).T @ residual)
            R, centre = se3.rotation_exp(step[3:]), moved.mean(0)
            T = se3.compose(se3.make(R, centre - R @ centre + step[:3]), T)
        return T


MAX_ERROR = 0.03  # mean surface distance over the diameter; loose: a superfluous rotation costs little
MAX_ERROR_ABOUT_AXIS = 0.025  # the same for all rotations about an axis of revolution
STEP_RAD = np.radians(15.0)  # between rotations about an axis
DISTINCT_RAD = np.radians(20.0)  # between other rotations: refinement bridges smaller differences
MAX_ROTATIONS = 64  # of a model
_STARTS = 1500  # rotations spread over SO(3)
_POINTS = 400  # surfels that errors are measured on
_FIT_POINTS = 250  # surfels that fits use
_ITERATIONS = 15  # of point-to-plane ICP
_MAX_ROUGH_ERROR = 0.06  # mean error on the grid, which does not separate the two sides of a wall
_SAME_AXIS = np.cos(np.radians(7.0))  # cosine between directions of one axis


@dataclass(frozen=True, eq=False)
class NearSymmetries:
    """transforms (M, 4, 4), identity first; axis, offset (3,): direction and a point of the axis of
    revolution, or None; flip (4, 4): a rotation that reverses the axis, or None."""

    transforms: Float64
    axis: Float64 | None = None
    offset: Float64 | None = None
    flip: Float64 | None = None


def near_symmetries(surface: Surface, grid: DistanceGrid, diameter_m: float) -> NearSymmetries:
    """Near-symmetric rotations of a surface, at most `MAX_ROTATIONS`; about an axis of revolution one every
    15 degrees."""
    sided = SidedSurface.of(surface.points, surface.normals, diameter_m)
    points, normals = _measured_on(surface)
    error = partial(_error, sided, points, normals)
    centre = (surface.points.min(0) + surface.points.max(0)) / 2.0
    starts = np.stack([se3.make(R, centre - R @ centre) for R in even_rotations(_STARTS)])
    fits, rough = fitted(starts, surface, grid, diameter_m)
    order = np.argsort(rough, kind="stable")
    order = order[rough[order] < _MAX_ROUGH_ERROR]
    order = order[_distinct(fits[order], np.radians(8.0), 4 * MAX_ROTATIONS)]
    transforms = _sorted_by_error(fits[order], error)
    axis = axis_of_revolution(transforms, centre, error)
    if axis is None:
        kept = transforms[_distinct(transforms, DISTINCT_RAD, MAX_ROTATIONS - 1)]
        polished = np.array([sided.polished(T, points, normals) for T in kept])
        transforms = _sorted_by_error(polished, error)
        last = _distinct(transforms, DISTINCT_RAD, MAX_ROTATIONS - 1)
        return NearSymmetries(np.concatenate([np.eye(4)[None], transforms[last]]))
    direction, offset = axis
    about = rotations_about(direction, offset, STEP_RAD)
    reversing = [T for T in transforms if T[:3, :3] @ direction @ direction < -_SAME_AXIS]
    flip = sided.polished(reversing[0], points, normals) if reversing else None
    all_transforms = about if flip is None else np.concatenate([about, flip @ about])
    return NearSymmetries(all_transforms, direction, offset, flip)


def _measured_on(surface: Surface) -> tuple[Float64, Float64]:
    """The points and normals (N, 3) that errors are measured on."""
    return surface.points[:_POINTS].astype(np.float64), surface.normals[:_POINTS].astype(np.float64)


def _error(sided: SidedSurface, points: Float64, normals: Float64, T: Float64) -> float:
    """Mean distance of transformed points from the surface, over the diameter."""
    return float(sided.offsets(T, points, normals)[0].mean())


def revolves(surface: Surface, diameter_m: float, direction: Float, offset: Float) -> bool:
    """Whether every rotation about a line through `offset` is a near-symmetry."""
    sided = SidedSurface.of(surface.points, surface.normals, diameter_m)
    error = partial(_error, sided, *_measured_on(surface))
    return all(error(T) < MAX_ERROR_ABOUT_AXIS for T in rotations_about(direction, offset, STEP_RAD))


def _sorted_by_error(transforms: Float64, error: Callable[[Float64], float]) -> Float64:
    """The transforms below `MAX_ERROR`, best first."""
    transforms = transforms.reshape(-1, 4, 4)
    errors = np.array([error(T) for T in transforms]).reshape(-1)
    order = np.argsort(errors, kind="stable")
    return transforms[order[errors[order] < MAX_ERROR]]


def rotations_about(axis: Float, offset: Float, step_rad: float) -> Float64:
    """Rotations (S, 4, 4) about a line through `offset`, evenly spaced over the circle, identity first."""
    count = round(2 * np.pi / step_rad)
    return np.stack([rotation_about(axis, 2 * np.pi * k / count, offset) for k in range(count)])


def _distinct(transforms: Float64, apart_rad: float, most: int) -> Int64:
    """Indices of at most `most` transforms that differ by `apart_rad` from the identity and from each
    other; earlier ones are preferred."""
    with_identity = np.concatenate([np.eye(4)[None], transforms])
    return np.asarray(first_different(with_identity, apart_rad, most + 1)[1:] - 1)


def axis_of_revolution(
    transforms: Float64, centre: Float, error: Callable[[Float64], float]
) -> tuple[Float64, Float64] | None:
    """Axis (direction, a point on it) about which every rotation is a near-symmetry, or None.

    transforms (N, 4, 4): near-symmetries, best first. If there are several axes, as for a sphere, the one
    with the least error is taken.
    """
    vectors = np.array([se3.rotation_log(T[:3, :3]) for T in transforms]).reshape(-1, 3)
    angles = np.linalg.norm(vectors, axis=1)
    usable = (angles > np.radians(20)) & (angles < np.radians(170))
    axes, members = vectors[usable] / angles[usable, None], transforms[usable]
    best: tuple[float, Float64, Float64] | None = None
    tried: list[Float64] = []
    for seed in axes:
        if any(abs(seed @ t) > _SAME_AXIS for t in tried) or len(tried) == 12:
            continue
        tried.append(seed)
        same = np.abs(axes @ seed) > _SAME_AXIS
        if same.sum() < 6:
            continue
        direction = np.linalg.eigh(axes[same].T @ axes[same])[1][:, 2]
        direction = direction * np.sign(direction[int(np.argmax(np.abs(direction)))])
        # A point that all transforms leave in place, (I - R) p = t, and of those the nearest to the centre.
        A = np.concatenate([np.eye(3) - T[:3, :3] for T in members[same]] + [1e-3 * np.eye(3)])
        b = np.concatenate([T[:3, 3] for T in members[same]] + [1e-3 * centre])
        offset = np.linalg.lstsq(A, b, rcond=None)[0]
        errors = np.array([error(T) for T in rotations_about(direction, offset, STEP_RAD)])
        if errors.max() < MAX_ERROR_ABOUT_AXIS and (best is None or errors.mean() < best[0]):
            best = (float(errors.mean()), direction, offset)
    return None if best is None else best[1:]


def even_rotations(count: int) -> Float64:
    """Rotations (count, 3, 3) spread evenly over SO(3): super-Fibonacci spirals (Alexa, CVPR 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, R = np.sqrt(s / count), np.sqrt(1 - s / count)
    a, b = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    quaternions = np.stack([r * np.sin(a), r * np.cos(a), R * np.sin(b), R * np.cos(b)], 1)
    return np.stack([se3.rotation_from_quaternion(q) for q in quaternions])


def fitted(
    transforms: Float64, surface: Surface, grid: DistanceGrid, diameter_m: float
) -> tuple[Float64, Float64]:
    """Transforms (M, 4, 4) after point-to-plane ICP of the surface onto itself, and their mean errors (M,)
    over the diameter. The error of a surfel is at least 0.05 if its normal differs by more than 60 degrees
    from the surface's."""
    out = np.ascontiguousarray(transforms, np.float64).copy()
    errors = np.empty(len(out))
    _fit_all(out, errors, surface_arrays(surface, grid), float(diameter_m))
    return np.stack([se3.orthonormalised(T) for T in out]), errors


@jit
def _fit_all(transforms: Float64, errors: Float64, surface: SurfaceArrays, d: float) -> None:
    points, normals, nearest = surface.samples, surface.normals, surface.nearest
    low, step, count = surface.origin, surface.step, min(_FIT_POINTS, points.shape[0])
    J = np.empty(6)
    for m in range(transforms.shape[0]):
        T = transforms[m]
        for it in range(_ITERATIONS + 1):
            scale = d * (0.10 + (0.03 - 0.10) * min(1.0, it / max(1.0, 0.6 * _ITERATIONS)))
            A = np.zeros((6, 6))
            b = np.zeros(6)
            error = 0.0
            for i in range(count):
                p, n = points[i], normals[i]
                q0 = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
                q1 = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
                q2 = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
                a0 = min(max(int((q0 - low[0]) / step + 0.5), 0), nearest.shape[0] - 1)
                a1 = min(max(int((q1 - low[1]) / step + 0.5), 0), nearest.shape[1] - 1)
                a2 = min(max(int((q2 - low[2]) / step + 0.5), 0), nearest.shape[2] - 1)
                j = nearest[a0, a1, a2]
                s, sn = points[j], normals[j]
                e0, e1, e2 = q0 - s[0], q1 - s[1], q2 - s[2]
                r = e0 * sn[0] + e1 * sn[1] + e2 * sn[2]
                distance = np.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
                facing = 0.0
                for k in range(3):
                    facing += (T[k, 0] * n[0] + T[k, 1] * n[1] + T[k, 2] * n[2]) * sn[k]
                error += abs(r) if facing > 0.5 else max(abs(r), 0.05 * d)
                w = max(facing, 0.05) / (1.0 + (distance / scale) ** 2)
                J[0] = q1 * sn[2] - q2 * sn[1]
                J[1] = q2 * sn[0] - q0 * sn[2]
                J[2] = q0 * sn[1] - q1 * sn[0]
                J[3], J[4], J[5] = sn[0], sn[1], sn[2]
                for a in range(6):
                    b[a] -= w * r * J[a]
                    for c in range(6):
                        A[a, c] += w * J[a] * J[c]
            errors[m] = error / (count * d)
            if it == _ITERATIONS:
                break
            for a in range(3):  # damps motions that the surface does not determine
                A[a, a] += 2e-4 * d * d * count
                A[a + 3, a + 3] += 2e-3 * count
            x = np.linalg.solve(A, b)
            angle = np.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
            R = np.eye(3)
            if angle > 1e-12:
                k0, k1, k2 = x[0] / angle, x[1] / angle, x[2] / angle
                K = np.array([[0.0, -k2, k1], [k2, 0.0, -k0], [-k1, k0, 0.0]])
                R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)
            moved = R @ np.ascontiguousarray(T[:3, :])
            T[:3, :] = moved
            T[0, 3] += x[3]
            T[1, 3] += x[4]
            T[2, 3] += x[5]
