"""A dense coloured point cloud of the visible part of a mesh, and averages of its colours and normals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64
from huepose.geometry.mesh import Mesh
from huepose.onboarding.neighbourhoods import Cells
from huepose.onboarding.visibility import DepthViews, votes
from huepose.onboarding.winding import outward_sign

_SAMPLES_PER_MM2, _MIN_SAMPLES, _MAX_SAMPLES = 2.0, 40_000, 300_000  # samples on the whole surface


@dataclass(frozen=True, eq=False)
class Cloud:
    """Samples in random order: points (M, 3) float64 metres, normals (M, 3) float64, lab (M, 3) float32;
    area_m2: of the visible surface."""

    points: Float64
    normals: Float64
    lab: Float32
    area_m2: float

    @cached_property
    def tree(self) -> Any:
        """scipy's search tree of the points."""
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    def cells(self, radius_m: float) -> Cells:
        """The samples, sorted for averages within a radius; kept for the next call."""
        if radius_m not in self._cells:
            self._cells[radius_m] = Cells.of(self.points, self.normals, self.lab, radius_m)
        return self._cells[radius_m]

    @cached_property
    def _cells(self) -> dict[float, Cells]:
        return {}


def visible_cloud(mesh: Mesh, views: DepthViews) -> Cloud:
    """Uniform random samples of the surface that is visible in some view. Inner walls are left out.

    Normals point outwards for a closed mesh. For an open mesh, or one with inconsistent faces, they point
    to the side that is visible in more views.
    """
    rng = np.random.default_rng(0)
    face_normals, areas = mesh.face_normals()
    total = float(areas.sum())
    count = int(np.clip(total * 1e6 * _SAMPLES_PER_MM2, _MIN_SAMPLES, _MAX_SAMPLES))
    at = (np.arange(count) + rng.random(count)) * (total / count)  # one sample in each equal share of area
    face = np.minimum(np.searchsorted(np.cumsum(areas), at), len(areas) - 1)
    a, b = rng.random((2, count))
    inside_out = a + b > 1
    a, b = np.where(inside_out, 1 - a, a), np.where(inside_out, 1 - b, b)
    weights = np.stack([1 - a - b, a, b], 1)
    points = np.einsum("nk,nkd->nd", weights, mesh.vertices.astype(np.float64)[mesh.faces[face]])
    normals = face_normals[face]
    sign = outward_sign(mesh.vertices, mesh.faces)
    if sign != 0:
        normals = normals * sign
        is_seen = votes(views, points, normals, enough=1) > 0
    else:
        front, back = votes(views, points, normals), votes(views, points, -normals)
        normals = np.where((back > front)[:, None], -normals, normals)
        is_seen = np.maximum(front, back) > 0
    order = rng.permutation(count)
    if is_seen.mean() > 0.01:  # otherwise it is too small or thin for the views
        order = order[is_seen[order]]
    uv = np.einsum("nk,nkd->nd", weights[order], mesh.uv[face[order]].astype(np.float64))
    return Cloud(points[order], normals[order], _texels(lab_texture(mesh), uv), total * len(order) / count)


def lab_texture(mesh: Mesh) -> Float32:
    """Texture in CIELAB (H, W, 3) float32, L 0..100."""
    return np.asarray(cv2.cvtColor(mesh.texture.astype(np.float32) / 255.0, cv2.COLOR_RGB2Lab), np.float32)


def _texels(picture: Float32, uv: Float64) -> Float32:
    height, width = picture.shape[:2]
    x = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    y = np.clip((uv[:, 1] * height).astype(int), 0, height - 1)
    return np.asarray(picture[y, x], np.float32)


def smoothed_normals(cloud: Cloud, points: Float, normals: Float, radius_m: float) -> Float64:
    """Mean normals (N, 3) of the cloud within a radius, of samples that face like `normals` (N, 3)."""
    total = cloud.cells(radius_m).facing_sum(points, normals, least_cosine=0.5)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-9, total / np.maximum(length, 1e-9), normals)


def averaged_lab(cloud: Cloud, points: Float, normals: Float, sigma_m: float) -> Float32:
    """Lab colours (N, 3) at `points`: Gaussian mean with sigma `sigma_m` over samples with similar normals;
    the colour of the nearest sample if none is near."""
    mean, weight = cloud.cells(2.5 * sigma_m).gaussian(points, normals, sigma_m)
    lonely = weight < 1e-6
    if lonely.any():
        mean[lonely] = cloud.lab[cloud.tree.query(np.asarray(points)[lonely])[1]]
    return mean.astype(np.float32)
