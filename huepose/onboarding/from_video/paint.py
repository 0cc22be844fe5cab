"""A texture from the pictures themselves: finer than the cells of the volume."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float32, Float64
from huepose.geometry.mesh import Mesh
from huepose.onboarding.from_video.fusion import Fused
from huepose.onboarding.from_video.views import View, projected, tolerance_m
from huepose.onboarding.patches import fitting_patches
from huepose.onboarding.texture import reduced
from huepose.propose.flow import sampled

SHARPNESS = 6
"""Power of the cosine by which views are averaged: the squarest count, seams fade over some ten degrees."""


def painted(shape: Fused, views: Sequence[View]) -> Mesh:
    """The surface with the colours of the views; what none saw has their mean."""
    layout = fitting_patches(shape.vertices, shape.faces)
    corners, normals = shape.vertices[shape.faces], shape.normals[shape.faces]
    seen_colors = np.concatenate([view.frame.color[view.inner] for view in views])
    plain = seen_colors.mean(0)
    pictures = [(view, view.frame.color.astype(np.float32)) for view in views]

    def colors(faces: np.ndarray, weights: Float64) -> Float:
        points = np.einsum("fk,fkd->fd", weights, corners[faces])
        normal = np.einsum("fk,fkd->fd", weights, normals[faces])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        return _colors(points, normal, pictures, plain)

    texture = layout.baked(colors)
    # Texels between the triangles, which coarser levels of the picture average in.
    texture = reduced(texture, np.asarray(texture.any(2), np.uint8))
    return Mesh(shape.vertices.astype(np.float32), shape.faces, layout.uv, texture)


def _colors(
    points: Float64, normals: Float64, pictures: Sequence[tuple[View, Float32]], plain: Float64
) -> Float64:
    total, weight = np.zeros((len(points), 3)), np.zeros(len(points))
    for view, picture in pictures:
        row, column, z = projected(points, view)
        p = se3.apply(view.T_cam_obj, points)
        cosine = -((normals @ view.T_cam_obj[:3, :3].T) * p).sum(1) / np.linalg.norm(p, axis=1)
        near = np.abs(view.frame.depth[row, column] - z) < tolerance_m(z)
        seen = np.flatnonzero((row >= 0) & view.inner[row, column] & near & (cosine > 0.1))
        w = cosine[seen] ** SHARPNESS / z[seen] ** 2
        total[seen] += w[:, None] * sampled(picture, view.frame.camera.project(p[seen]))
        weight[seen] += w
    known = weight > 0
    out = np.tile(np.asarray(plain, np.float64), (len(points), 1))
    out[known] = total[known] / weight[known, None]
    return out
