"""Per-pixel attributes of the visible triangles, perspective-correct.

Over the camera-frame corners v0 v1 v2 of a triangle, a viewing ray r has barycentric coordinates
proportional to r.(v1 x v2), r.(v2 x v0), r.(v0 x v1) (homogeneous rasterisation, Olano and Greer 1997): right
also where the triangle passes behind the camera.
"""

from __future__ import annotations

import math

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int32, Int64, UInt8
from huepose.support.jit import jit


@jit
def _barycentric(points: Float64, face: Int32, x: float, y: float, weights: Float64) -> tuple[float, float]:
    """Weights (3) of the corners for the ray (x, y, 1); returns their first sum and det[v0 v1 v2]."""
    a, b, c = points[face[0]], points[face[1]], points[face[2]]
    weights[0] = x * (b[1] * c[2] - b[2] * c[1]) + y * (b[2] * c[0] - b[0] * c[2]) + b[0] * c[1] - b[1] * c[0]
    weights[1] = x * (c[1] * a[2] - c[2] * a[1]) + y * (c[2] * a[0] - c[0] * a[2]) + c[0] * a[1] - c[1] * a[0]
    weights[2] = x * (a[1] * b[2] - a[2] * b[1]) + y * (a[2] * b[0] - a[0] * b[2]) + a[0] * b[1] - a[1] * b[0]
    total = weights[0] + weights[1] + weights[2]
    volume = (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    # Rounding can leave a pixel on an edge a trace outside: kept inside, so that nothing is extrapolated.
    sign = 1.0 if total >= 0 else -1.0
    clipped = 0.0
    for k in range(3):
        weights[k] = max(sign * weights[k], 0.0)
        clipped += weights[k]
    for k in range(3):
        weights[k] = weights[k] / clipped if clipped > 0 else 1.0 / 3.0
    return total, volume


@jit
def _texel(texels: UInt8, levels: Int64, level: int, s: float, t: float, weight: float, out: Float64) -> None:
    """Add `weight` times the bilinear colour at texture coordinates (s, t) of one level to `out` (3)."""
    offset, height, width = levels[level, 0], levels[level, 1], levels[level, 2]
    x = min(max(s * width - 0.5, 0.0), width - 1.0)
    y = min(max(t * height - 0.5, 0.0), height - 1.0)
    x0, y0 = int(x), int(y)
    x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
    fx, fy = x - x0, y - y0
    top, bottom = offset + y0 * width, offset + y1 * width
    for k in range(3):
        upper = texels[top + x0, k] * (1.0 - fx) + texels[top + x1, k] * fx
        lower = texels[bottom + x0, k] * (1.0 - fx) + texels[bottom + x1, k] * fx
        out[k] += weight * (upper * (1.0 - fy) + lower * fy)


@jit
def paint(
    owner: Int32,
    faces_at: Int32,
    index: int,
    bounds: tuple[int, int, int, int],
    points: Float64,
    faces: Int32,
    uv: Float32,
    texels: UInt8,
    levels: Int64,
    focal: tuple[float, float],
    centre: tuple[float, float],
    color: UInt8,
) -> None:
    """Texture colour of the pixels owned by `index` into color (H, W, 3): trilinear in the pyramid.

    The level is where a texel is as large as the pixel: the Jacobian determinant of the projective map from
    the image to the texture, per pixel.
    """
    left, top, right, bottom = bounds
    weights, value = np.empty(3), np.empty(3)
    height, width = levels[0, 1], levels[0, 2]
    scale = height * width / (focal[0] * focal[1])
    for row in range(top, bottom + 1):
        y = (row - centre[1]) / focal[1]
        for column in range(left, right + 1):
            if owner[row, column] != index:
                continue
            f = faces_at[row, column]
            total, volume = _barycentric(points, faces[f], (column - centre[0]) / focal[0], y, weights)
            s = weights[0] * uv[f, 0, 0] + weights[1] * uv[f, 1, 0] + weights[2] * uv[f, 2, 0]
            t = weights[0] * uv[f, 0, 1] + weights[1] * uv[f, 1, 1] + weights[2] * uv[f, 2, 1]
            if s < 0 or s > 1:
                s -= math.floor(s)
            if t < 0 or t > 1:
                t -= math.floor(t)
            area = (uv[f, 1, 0] - uv[f, 0, 0]) * (uv[f, 2, 1] - uv[f, 0, 1]) - (uv[f, 1, 1] - uv[f, 0, 1]) * (
                uv[f, 2, 0] - uv[f, 0, 0]
            )
            stretch = abs(area * scale * volume * volume / (total * total * total)) if total != 0 else 1.0
            depth = min(max(0.5 * math.log2(max(stretch, 1e-12)), 0.0), levels.shape[0] - 1.0)
            level = int(depth)
            part = depth - level
            value[:] = 0.0
            _texel(texels, levels, level, s, t, 1.0 - part, value)
            if part > 0:
                _texel(texels, levels, level + 1, s, t, part, value)
            for k in range(3):
                color[row, column, k] = np.uint8(min(value[k] + 0.5, 255.0))


@jit
def locate(
    owner: Int32,
    faces_at: Int32,
    index: int,
    bounds: tuple[int, int, int, int],
    points: Float64,
    faces: Int32,
    corner_values: Float32,
    focal: tuple[float, float],
    centre: tuple[float, float],
    out: Float32,
) -> None:
    """Interpolate values at face corners (F, 3, 3) over the pixels owned by `index` into out (H, W, 3)."""
    left, top, right, bottom = bounds
    weights = np.empty(3)
    for row in range(top, bottom + 1):
        y = (row - centre[1]) / focal[1]
        for column in range(left, right + 1):
            if owner[row, column] != index:
                continue
            f = faces_at[row, column]
            _barycentric(points, faces[f], (column - centre[0]) / focal[0], y, weights)
            for k in range(3):
                out[row, column, k] = (
                    weights[0] * corner_values[f, 0, k]
                    + weights[1] * corner_values[f, 1, k]
                    + weights[2] * corner_values[f, 2, k]
                )


@jit
def turn_normals(
    owner: Int32,
    faces_at: Int32,
    index: int,
    bounds: tuple[int, int, int, int],
    points: Float64,
    faces: Int32,
    R: Float64,
    normals: Float32,
) -> None:
    """Model-frame normals of the pixels owned by `index` into the camera frame, unit length, in place;
    negated where the back of a face is seen."""
    left, top, right, bottom = bounds
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if owner[row, column] != index:
                continue
            face = faces[faces_at[row, column]]
            a, b, c = points[face[0]], points[face[1]], points[face[2]]
            volume = (
                a[0] * (b[1] * c[2] - b[2] * c[1])
                + a[1] * (b[2] * c[0] - b[0] * c[2])
                + a[2] * (b[0] * c[1] - b[1] * c[0])
            )
            x = np.float64(normals[row, column, 0])
            y = np.float64(normals[row, column, 1])
            z = np.float64(normals[row, column, 2])
            # det[a b c] is the face normal (twice the area) times a point of the face: positive from behind.
            scale = (-1.0 if volume > 0 else 1.0) / max(math.sqrt(x * x + y * y + z * z), 1e-12)
            for k in range(3):
                normals[row, column, k] = scale * (R[k, 0] * x + R[k, 1] * y + R[k, 2] * z)
