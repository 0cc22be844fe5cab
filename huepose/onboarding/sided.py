"""Nearest-neighbour search among oriented points: the nearest surface sample that faces the same way.

Position and scaled normal are searched together, so that the two sides of a thin wall are far apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64, Int64

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
