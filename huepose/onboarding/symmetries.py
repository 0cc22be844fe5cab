"""Find symmetries of shape *and texture*: rotations under which the object looks the same.

The near-symmetries of the shape (`near_symmetries`) are candidates. Each is tested strictly on the surface
and then on the texture: where a rotated surfel lands, the surface must have nearly the same colour, for
almost all surfels, at both colour scales.

`SidedSurface` searches position and scaled normal together, so that the two sides of a thin wall are far
apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float64, Int64
from huepose.model.types import COLOR_SCALES_M, Surface
from huepose.onboarding.cloud import Cloud, averaged_lab
from huepose.onboarding.near_symmetries import NearSymmetries, rotations_about

_NORMAL_LENGTH = 0.05  # of the diameter: samples that face away are a tenth of a diameter farther


@dataclass(frozen=True, eq=False)
class SidedSurface:
    """points, normals (N, 3) of a surface, searched in both at once; diameter_m of the object."""

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

    def offsets(self, turn: Float, points: Float, normals: Float) -> tuple[Float64, Float64]:
        """Distances of transformed points (M, 3) with normals from the surface, over the diameter: to its
        tangent plane (M,) and to the sample itself (M,); at least a twentieth where the surface faces another
        way."""
        moved, turned = se3.apply(turn, points), normals @ turn[:3, :3].T
        j = self.nearest(moved, turned)
        gap = moved - self.points[j]
        elsewhere = np.einsum("md,md->m", self.normals[j], turned) < 0.5
        plane = np.abs(np.einsum("md,md->m", gap, self.normals[j])) / self.diameter_m
        distance = np.linalg.norm(gap, axis=1) / self.diameter_m
        return np.maximum(plane, 0.05 * elsewhere), np.maximum(distance, 0.05 * elsewhere)

    def polished(self, turn: Float64, points: Float, normals: Float) -> Float64:
        """Refine a transform (4, 4) by eight point-to-plane steps of the transformed points onto the
        surface."""
        T = turn
        for _ in range(8):
            moved, turned = se3.apply(T, points), normals @ T[:3, :3].T
            j = self.nearest(moved, turned)
            n = self.normals[j]
            gap = moved - self.points[j]
            residual = np.einsum("md,md->m", gap, n)
            weight = 1.0 / (1.0 + (np.linalg.norm(gap, axis=1) / (0.02 * self.diameter_m)) ** 2)
            weight *= np.maximum(np.einsum("md,md->m", n, turned), 0.0)
            lever = moved - moved.mean(0)
            J = np.hstack([n, np.cross(lever, n)])
            damping = np.diag([1e-3] * 3 + [1e-3 * self.diameter_m**2 / 12] * 3) * weight.sum()
            step = np.linalg.solve((J * weight[:, None]).T @ J + damping, -(J * weight[:, None]).T @ residual)
            R, centre = se3.rotation_exp(step[3:]), moved.mean(0)
            T = se3.compose(se3.make(R, centre - R @ centre + step[:3]), T)
        return T


EQUIVALENT_STEP_RAD = np.radians(5.0)
_MAX_MEAN_ERROR = 0.006  # mean distance to the own surface over the diameter
_OUTLIER_ERROR = 0.03  # distance of an outlier, as on a handle, a spout, a hole
_MAX_OUTLIERS = 0.03  # share of surfels
_MAX_MEAN_COLOR, _OUTLIER_COLOR, _MAX_COLOR_OUTLIERS = 3.0, 12.0, 0.03  # distances in (L / 2, a, b); share
_POINTS = 800  # surfels of the test that decides
_QUICK_POINTS = 150  # surfels of a first test, which rejects most cases


def equivalent_rotations(surface: Surface, cloud: Cloud, near: NearSymmetries, diameter_m: float) -> Float64:
    """Rotations (E, 4, 4), identity first, under which shape and texture look the same.

    About an axis of revolution: one every 5 degrees if all tested rotations look the same, else the largest
    set of equal steps that do.
    """
    sided = SidedSurface.of(cloud.points, cloud.normals, diameter_m)
    same = np.array(
        [k == 0 or looks_the_same(surface, cloud, sided, T) for k, T in enumerate(near.transforms)]
    )
    if near.axis is None or near.offset is None:
        return np.asarray(near.transforms[same])
    steps = len(near.transforms) if near.flip is None else len(near.transforms) // 2
    order = _order_of_subgroup(same[:steps])
    about = rotations_about(near.axis, near.offset, EQUIVALENT_STEP_RAD)
    if order < steps:
        about = near.transforms[: steps : steps // order]
    if near.flip is None or not same[steps :: steps // order].all():
        return np.asarray(about)
    return np.concatenate([about, near.flip @ about])


def _order_of_subgroup(same: Bool) -> int:
    """Order of the largest cyclic group of which all rotations look the same; same (n,): results at n equal
    steps."""
    count = len(same)
    return max(n for n in range(1, count + 1) if count % n == 0 and same[:: count // n].all())


def looks_the_same(surface: Surface, cloud: Cloud, sided: SidedSurface, turn: Float64) -> bool:
    """Whether neither the rotated shape nor the rotated texture differs visibly from the object."""
    for count in (_QUICK_POINTS, _POINTS):
        # At a glance only what is clearly different is turned away.
        slack = 2.5 if count == _QUICK_POINTS else 1.0
        points = surface.points[:count].astype(np.float64)
        plane, distance = sided.offsets(turn, points, surface.normals[:count].astype(np.float64))
        if (
            plane.mean() > slack * _MAX_MEAN_ERROR
            or (distance > _OUTLIER_ERROR).mean() > slack * _MAX_OUTLIERS
        ):
            return False
        for scale in (1, 0):
            difference = texture_difference(surface, cloud, turn, scale, count)
            other = (difference > _OUTLIER_COLOR).mean() > slack * _MAX_COLOR_OUTLIERS
            if other or (scale == 1 and difference.mean() > slack * _MAX_MEAN_COLOR):
                return False
    return True


def texture_difference(surface: Surface, cloud: Cloud, turn: Float64, scale: int, count: int) -> Float64:
    """Colour distances (count,) in (L / 2, a, b) between `count` surfels and the surface where the rotation
    takes them, at one of the two scales of `Surface.lab`."""
    points = se3.apply(turn, surface.points[:count])
    normals = surface.normals[:count] @ turn[:3, :3].T
    there = averaged_lab(cloud, points, normals, COLOR_SCALES_M[scale])
    return np.asarray(np.linalg.norm((there - surface.lab[scale, :count]) * [0.5, 1.0, 1.0], axis=1))
