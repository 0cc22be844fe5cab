"""Per-pixel attributes of the visible triangles, perspective-correct.

For the camera-frame corners v0 v1 v2 of a triangle, a viewing ray r has barycentric coordinates
proportional to r.(v1 x v2), r.(v2 x v0), r.(v0 x v1) (homogeneous rasterisation, Olano and Greer 1997).
This also holds where the triangle passes behind the camera. So an attribute is (r.n) / (r.d), with n and d
per triangle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int32, Int64, UInt8
from huepose.support.jit import jit


class Rasterised(NamedTuple):
    """A mesh in the z-buffer: owner (H, W) is `number` where the mesh is the nearest, faces_at (H, W) its
    triangle there; bounds: left, top, right, bottom pixel; points (V, 3), camera axes, and faces (F, 3)."""

    owner: Int32
    faces_at: Int32
    number: int
    bounds: tuple[int, int, int, int]
    points: Float64
    faces: Int32
    focal: tuple[float, float]
    centre: tuple[float, float]


@jit
def _edges(points: Float64, face: Int32, m: Float64) -> float:
    """The three cross products (3, 3) of a triangle's corners, and their sum in m[3]; returns det[v0 v1
    v2], which is positive for a triangle whose back the camera sees."""
    for k in range(3):
        a, b = points[face[(k + 1) % 3]], points[face[(k + 2) % 3]]
        m[k, 0] = a[1] * b[2] - a[2] * b[1]
        m[k, 1] = a[2] * b[0] - a[0] * b[2]
        m[k, 2] = a[0] * b[1] - a[1] * b[0]
    for c in range(3):
        m[3, c] = m[0, c] + m[1, c] + m[2, c]
    first = points[face[0]]
    volume: float = first[0] * m[0, 0] + first[1] * m[0, 1] + first[2] * m[0, 2]
    return volume


@jit
def _texel(
    texels: UInt8, offset: int, height: int, width: int, s: float, t: float
) -> tuple[float, float, float]:
    """Bilinear colour at texture coordinates (s, t) in 0..1 of the level that begins at `offset`."""
    x = min(max(s * width - 0.5, 0.0), width - 1.0)
    y = min(max(t * height - 0.5, 0.0), height - 1.0)
    x0, y0 = int(x), int(y)
    a = offset + y0 * width + x0
    b = a + (1 if x0 + 1 < width else 0)
    down = width if y0 + 1 < height else 0
    c, d = a + down, b + down
    fx, fy = np.float32(x - x0), np.float32(y - y0)
    w11 = fx * fy
    w10, w01 = fy - w11, fx - w11
    w00 = np.float32(1.0) - fx - w10
    red = w00 * texels[a, 0] + w01 * texels[b, 0] + w10 * texels[c, 0] + w11 * texels[d, 0]
    green = w00 * texels[a, 1] + w01 * texels[b, 1] + w10 * texels[c, 1] + w11 * texels[d, 1]
    blue = w00 * texels[a, 2] + w01 * texels[b, 2] + w10 * texels[c, 2] + w11 * texels[d, 2]
    return red, green, blue


@jit
def paint(mesh: Rasterised, uv: Float32, texels: UInt8, levels: Int64, color: UInt8) -> None:
    """Write the texture colour of the pixels of a mesh into color (H, W, 3), trilinear in the pyramid.

    The level is the one at which a texel is as large as the pixel, by the Jacobian determinant of the
    projective map from the image to the texture, per pixel.
    """
    left, top, right, bottom = mesh.bounds
    focal, centre = mesh.focal, mesh.centre
    m, s_of, t_of = np.empty((4, 3)), np.empty(3), np.empty(3)
    scale = levels[0, 1] * levels[0, 2] / (focal[0] * focal[1])
    last, top_level, base = -1, levels.shape[0] - 1, 0.0
    low_s, high_s, low_t, high_t = 0.0, 1.0, 0.0, 1.0
    for row in range(top, bottom + 1):
        y = (row - centre[1]) / focal[1]
        for column in range(left, right + 1):
            if mesh.owner[row, column] != mesh.number:
                continue
            f = mesh.faces_at[row, column]
            if f != last:
                last = f
                volume = _edges(mesh.points, mesh.faces[f], m)
                s0, s1, s2 = np.float64(uv[f, 0, 0]), np.float64(uv[f, 1, 0]), np.float64(uv[f, 2, 0])
                t0, t1, t2 = np.float64(uv[f, 0, 1]), np.float64(uv[f, 1, 1]), np.float64(uv[f, 2, 1])
                for k in range(3):
                    s_of[k] = s0 * m[0, k] + s1 * m[1, k] + s2 * m[2, k]
                    t_of[k] = t0 * m[0, k] + t1 * m[1, k] + t2 * m[2, k]
                area = (s1 - s0) * (t2 - t0) - (t1 - t0) * (s2 - s0)
                base = 0.5 * math.log2(max(abs(area * scale * volume * volume), 1e-300))
                low_s, high_s = min(s0, s1, s2), max(s0, s1, s2)
                low_t, high_t = min(t0, t1, t2), max(t0, t1, t2)
            x = (column - centre[0]) / focal[0]
            total = x * m[3, 0] + y * m[3, 1] + m[3, 2]
            if total == 0.0:
                total = 1e-300
            s = min(max((x * s_of[0] + y * s_of[1] + s_of[2]) / total, low_s), high_s)
            t = min(max((x * t_of[0] + y * t_of[1] + t_of[2]) / total, low_t), high_t)
            if s < 0 or s > 1:
                s -= math.floor(s)
            if t < 0 or t > 1:
                t -= math.floor(t)
            where = min(max(base - 1.5 * math.log2(abs(total)), 0.0), float(top_level))
            level = int(where)
            part = where - level
            red, green, blue = _texel(texels, levels[level, 0], levels[level, 1], levels[level, 2], s, t)
            if level < top_level and part > 0.0:
                up = level + 1
                r, g, b = _texel(texels, levels[up, 0], levels[up, 1], levels[up, 2], s, t)
                red, green, blue = (
                    red + part * (r - red),
                    green + part * (g - green),
                    blue + part * (b - blue),
                )
            color[row, column, 0] = np.uint8(red + 0.5)
            color[row, column, 1] = np.uint8(green + 0.5)
            color[row, column, 2] = np.uint8(blue + 0.5)


@jit
def locate(mesh: Rasterised, corner_values: Float32, rows: Int64, columns: Int64, out: Float32) -> None:
    """Interpolate values at face corners (F, 3, 3) into out (N, 3), at those of the pixels (N,) that show
    the mesh."""
    focal, centre = mesh.focal, mesh.centre
    m, of, low, high = np.empty((4, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    last = -1
    for n in range(rows.shape[0]):
        row, column = rows[n], columns[n]
        if mesh.owner[row, column] != mesh.number:
            continue
        f = mesh.faces_at[row, column]
        if f != last:
            last = f
            _edges(mesh.points, mesh.faces[f], m)
            for k in range(3):
                a, b, c = corner_values[f, 0, k], corner_values[f, 1, k], corner_values[f, 2, k]
                low[k], high[k] = min(a, b, c), max(a, b, c)
                for e in range(3):
                    of[k, e] = a * m[0, e] + b * m[1, e] + c * m[2, e]
        x, y = (column - centre[0]) / focal[0], (row - centre[1]) / focal[1]
        total = x * m[3, 0] + y * m[3, 1] + m[3, 2]
        inverse = 1.0 / total if total != 0.0 else 0.0
        for k in range(3):
            value = (x * of[k, 0] + y * of[k, 1] + of[k, 2]) * inverse
            out[n, k] = min(max(value, low[k]), high[k])


@jit
def rotate_normals(mesh: Rasterised, R: Float64, rows: Int64, columns: Int64, normals: Float32) -> None:
    """Rotate model-frame normals (N, 3) into the camera frame, in place and with unit length, at those of
    the pixels (N,) that show the mesh. They are negated where the camera sees the back of a face."""
    m = np.empty((4, 3))
    last, side = -1, 1.0
    for n in range(rows.shape[0]):
        row, column = rows[n], columns[n]
        if mesh.owner[row, column] != mesh.number:
            continue
        f = mesh.faces_at[row, column]
        if f != last:
            last = f
            side = -1.0 if _edges(mesh.points, mesh.faces[f], m) > 0 else 1.0
        x, y, z = np.float64(normals[n, 0]), np.float64(normals[n, 1]), np.float64(normals[n, 2])
        scale = side / max(math.sqrt(x * x + y * y + z * z), 1e-12)
        for k in range(3):
            normals[n, k] = scale * (R[k, 0] * x + R[k, 1] * y + R[k, 2] * z)
