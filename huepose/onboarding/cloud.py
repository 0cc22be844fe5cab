"""A dense coloured cloud of the part of a mesh that can be seen, and averages of its colours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64
from huepose.geometry.mesh import Mesh
from huepose.onboarding.visibility import DepthViews, sides_seen

_PER_SQUARE_MM = 2.0
_FEWEST, _MOST = 60_000, 300_000


@dataclass(frozen=True, eq=False)
class Cloud:
    """points, normals (M, 3) float64, lab (M, 3) float32, in random order; area_m2 of the visible surface."""

    points: Float64
    normals: Float64
    lab: Float32
    area_m2: float

    @cached_property
    def tree(self) -> Any:
        """scipy's search tree of the points."""
        from scipy.spatial import cKDTree

        return cKDTree(self.points)


def visible_cloud(mesh: Mesh, views: DepthViews, seed: int = 0) -> Cloud:
    """Evenly random samples of the surface that some view sees.

    Hidden inner walls are left out; where only the back of a face is ever seen, its normal is turned round.
    """
    rng = np.random.default_rng(seed)
    face_normals, areas = mesh.face_normals()
    total = float(areas.sum())
    count = int(np.clip(total * 1e6 * _PER_SQUARE_MM, _FEWEST, _MOST))
    at = (np.arange(count) + rng.random(count)) * (total / count)  # one sample in each equal share of area
    face = np.minimum(np.searchsorted(np.cumsum(areas), at), len(areas) - 1)
    a, b = rng.random((2, count))
    inside_out = a + b > 1
    a, b = np.where(inside_out, 1 - a, a), np.where(inside_out, 1 - b, b)
    weights = np.stack([1 - a - b, a, b], 1)
    points = np.einsum("nk,nkd->nd", weights, mesh.vertices.astype(np.float64)[mesh.faces[face]])
    side = sides_seen(views, points, face_normals[face])
    order = rng.permutation(count)
    order = order[side[order] != 0]
    if len(order) < count // 100:  # a surface so small or thin that no view resolves it
        order, side = rng.permutation(count), np.ones(count, np.int8)
    uv = np.einsum("nk,nkd->nd", weights[order], mesh.uv[face[order]].astype(np.float64))
    normals = face_normals[face[order]] * side[order, None]
    return Cloud(points[order], normals, _texels(lab_texture(mesh), uv), total * len(order) / count)


def lab_texture(mesh: Mesh) -> Float32:
    """Texture in CIELAB (H, W, 3) float32, L 0..100."""
    return np.asarray(cv2.cvtColor(mesh.texture.astype(np.float32) / 255.0, cv2.COLOR_RGB2Lab), np.float32)


def _texels(picture: Float32, uv: Float64) -> Float32:
    height, width = picture.shape[:2]
    x = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    y = np.clip((uv[:, 1] * height).astype(int), 0, height - 1)
    return np.asarray(picture[y, x], np.float32)


def smoothed_normals(cloud: Cloud, points: Float, normals: Float, radius_m: float) -> Float64:
    """Mean normals (N, 3) of the cloud within a radius, of the same side as `normals`."""
    out = np.array(normals, np.float64)
    for i, near in enumerate(cloud.tree.query_ball_point(points, radius_m)):
        others = cloud.normals[near]
        mean = others[others @ out[i] > 0.5].sum(0)
        length = np.linalg.norm(mean)
        if length > 1e-9:
            out[i] = mean / length
    return out


def averaged_lab(cloud: Cloud, points: Float, normals: Float, sigma_m: float) -> Float32:
    """Lab colours (N, 3) of the surface at `points`, Gaussian-weighted over `sigma_m` of what faces alike;
    where no sample is within reach, that of the nearest."""
    out = np.empty((len(points), 3), np.float32)
    nearest = cloud.tree.query(points)[1]
    for i, near in enumerate(cloud.tree.query_ball_point(points, 2.5 * sigma_m)):
        square = ((cloud.points[near] - points[i]) ** 2).sum(1)
        weight = np.exp(-square / (2 * sigma_m**2)) * np.maximum(cloud.normals[near] @ normals[i], 0.0)
        total = weight.sum()
        out[i] = weight @ cloud.lab[near] / total if total > 1e-6 else cloud.lab[nearest[i]]
    return out
