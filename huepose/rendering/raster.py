"""The z-buffer kernel: which triangle of a mesh is nearest in each pixel, and how far.

Inverse depth is linear in the image over a plane, so the buffer holds 1/z, and the largest value is the
nearest."""

from __future__ import annotations

import math

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int32
from huepose.support.jit import jit

EDGE = 1e-7  # px by which triangles are widened, so that neighbours leave no gap between them


@jit
def transform(vertices: Float32, T: Float64) -> Float64:
    """Camera-frame vertices (V, 3) of model vertices (V, 3) at pose T (4, 4)."""
    out = np.empty((vertices.shape[0], 3), np.float64)
    for i in range(vertices.shape[0]):
        x, y, z = np.float64(vertices[i, 0]), np.float64(vertices[i, 1]), np.float64(vertices[i, 2])
        for k in range(3):
            out[i, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]
    return out


@jit
def _fill(
    p: Float64, cx: float, cy: float, face: int, index: int, inverse: Float32, faces_out: Int32, owner: Int32
) -> tuple[int, int, int, int]:
    """Fill one projected triangle p (3, 3): x, y relative to the principal point in px, and 1/z.

    Row by row between the crossings of its edges. Returns the pixel bounds that it touched.
    """
    height, width = inverse.shape
    nothing = (width, height, -1, -1)
    y_min, y_max = min(p[0, 1], p[1, 1], p[2, 1]), max(p[0, 1], p[1, 1], p[2, 1])
    if not (y_max + cy >= -1.0 and y_min + cy <= height):
        return nothing
    row_0 = max(0, int(math.ceil(y_min + cy - EDGE)))
    row_1 = min(height - 1, int(math.floor(y_max + cy + EDGE)))
    if row_0 > row_1:
        return nothing
    x_min, x_max = min(p[0, 0], p[1, 0], p[2, 0]), max(p[0, 0], p[1, 0], p[2, 0])
    if not (x_max + cx >= -1.0 and x_min + cx <= width):
        return nothing
    column_0 = max(0, int(math.ceil(x_min + cx - EDGE)))
    column_1 = min(width - 1, int(math.floor(x_max + cx + EDGE)))
    if column_0 > column_1:
        return nothing
    ax, ay = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1]
    bx, by = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1]
    area = ax * by - ay * bx
    if abs(area) < 1e-14:
        return nothing
    da, db = p[1, 2] - p[0, 2], p[2, 2] - p[0, 2]
    slope_x, slope_y = (da * by - db * ay) / area, (db * ax - da * bx) / area
    low, high = min(p[0, 2], p[1, 2], p[2, 2]), max(p[0, 2], p[1, 2], p[2, 2])
    left, top, right, bottom = nothing
    for row in range(row_0, row_1 + 1):
        y = min(max(row - cy, y_min), y_max)
        lo, hi = x_max, x_min
        for e in range(3):
            f = e + 1 if e < 2 else 0
            y_e, y_f = p[e, 1], p[f, 1]
            if min(y_e, y_f) <= y <= max(y_e, y_f):
                x_e, x_f = p[e, 0], p[f, 0]
                if y_e == y_f:
                    lo, hi = min(lo, x_e, x_f), max(hi, x_e, x_f)
                else:
                    x = x_e + (x_f - x_e) * ((y - y_e) / (y_f - y_e))
                    lo, hi = min(lo, x), max(hi, x)
        first = max(column_0, int(math.ceil(lo + cx - EDGE)))
        last = min(column_1, int(math.floor(hi + cx + EDGE)))
        if first > last:
            continue
        left, right = min(left, first), max(right, last)
        top, bottom = min(top, row), row
        base = p[0, 2] + slope_y * (row - cy - p[0, 1]) + slope_x * (-cx - p[0, 0])
        for column in range(first, last + 1):
            value = np.float32(min(max(base + slope_x * column, low), high))
            if value > inverse[row, column]:
                inverse[row, column] = value
                faces_out[row, column] = face
                owner[row, column] = index
    return left, top, right, bottom


@jit
def _between(a: float, b: float, c: float, middle: float) -> bool:
    """Whether a triangle whose corners have these coordinates, relative to `middle`, lies between two rows
    or columns of pixel centres: no integer lies in their range."""
    return math.floor(max(a, b, c) + middle + EDGE) < min(a, b, c) + middle - EDGE


@jit
def rasterise(
    points: Float64,
    faces: Int32,
    focal: tuple[float, float],
    centre: tuple[float, float],
    near: float,
    closed: bool,
    index: int,
    inverse: Float32,
    faces_out: Int32,
    owner: Int32,
) -> tuple[int, int, int, int]:
    """Render camera-frame points (V, 3) with faces (F, 3) into the buffers of 1/z, face and owner (H, W).

    Triangles that cross the near plane are clipped there. closed: the surface is closed and all of it
    beyond the near plane, so its back faces (clockwise as the camera sees them) are skipped. `index` is the
    owner's number. Returns the bounds left, top, right, bottom (inclusive) of the pixels touched; right <
    left for none.
    """
    height, width = inverse.shape
    fx, fy = focal
    cx, cy = centre
    left, top, right, bottom = width, height, -1, -1
    flat = np.empty((points.shape[0], 3), np.float64)
    for i in range(points.shape[0]):
        z = points[i, 2]
        if z > near:
            flat[i, 0], flat[i, 1], flat[i, 2] = fx * points[i, 0] / z, fy * points[i, 1] / z, 1.0 / z
        else:
            flat[i, 0], flat[i, 1], flat[i, 2] = 0.0, 0.0, -1.0
    triangle = np.empty((3, 3), np.float64)
    corners = np.empty((4, 3), np.float64)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        front = (flat[a, 2] > 0) + (flat[b, 2] > 0) + (flat[c, 2] > 0)
        if front == 0:
            continue
        if closed:
            across, down = flat[b, 0] - flat[a, 0], flat[b, 1] - flat[a, 1]
            if across * (flat[c, 1] - flat[a, 1]) - down * (flat[c, 0] - flat[a, 0]) > 0.0:
                continue
        if front == 3:
            if _between(flat[a, 1], flat[b, 1], flat[c, 1], cy) or _between(
                flat[a, 0], flat[b, 0], flat[c, 0], cx
            ):
                continue
            for k in range(3):
                triangle[0, k], triangle[1, k], triangle[2, k] = flat[a, k], flat[b, k], flat[c, k]
            box = _fill(triangle, cx, cy, f, index, inverse, faces_out, owner)
            left, top = min(left, box[0]), min(top, box[1])
            right, bottom = max(right, box[2]), max(bottom, box[3])
            continue
        n = 0
        for e in range(3):
            i, j = faces[f, e], faces[f, e + 1 if e < 2 else 0]
            if flat[i, 2] > 0:
                corners[n] = flat[i]
                n += 1
            if (flat[i, 2] > 0) != (flat[j, 2] > 0):
                s = (near - points[i, 2]) / (points[j, 2] - points[i, 2])
                corners[n, 0] = fx * (points[i, 0] + s * (points[j, 0] - points[i, 0])) / near
                corners[n, 1] = fy * (points[i, 1] + s * (points[j, 1] - points[i, 1])) / near
                corners[n, 2] = 1.0 / near
                n += 1
        for k in range(2, n):
            triangle[0], triangle[1], triangle[2] = corners[0], corners[k - 1], corners[k]
            box = _fill(triangle, cx, cy, f, index, inverse, faces_out, owner)
            left, top = min(left, box[0]), min(top, box[1])
            right, bottom = max(right, box[2]), max(bottom, box[3])
    return left, top, right, bottom


@jit
def depth_of(inverse: Float32) -> Float32:
    """Depth in metres (H, W) of 1/z; 0 stays 0."""
    out = np.empty_like(inverse)
    for row in range(inverse.shape[0]):
        for column in range(inverse.shape[1]):
            value = inverse[row, column]
            out[row, column] = np.float32(1.0) / value if value > 0 else np.float32(0.0)
    return out
