"""Compiled loops over the surface samples that are visible at a pose: their pixels, and the depth and colour
there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Float64, Int32
from huepose.geometry.camera import NEAREST_M
from huepose.judge.kernel_arrays import ModelArrays, RegionArrays, shown_range
from huepose.support.jit import jit, jit_dividing

MIN_COSINE = 0.12
"""Samples seen more obliquely than this are left out: their depth and colour are mostly their neighbours'."""

AGREES, BEHIND, OCCLUDED, NO_DEPTH, OUTSIDE = range(5)
"""Comparison of a sample with the depth image: it agrees; depth lies behind the sample (free-space
violation); the sample is occluded; no reading; outside the window."""

FAR_ALONG_RAY = 4.0
"""A reading may be far from an oblique sample along the ray and yet near its tangent plane: at most this far,
in gates."""


class Samples(NamedTuple):
    """Buffers for up to M samples.

    which: index into the surface; points, normals (M, 3) camera axes; cosine of the viewing angle; pixels
    (M, 2); offset: metres of the depth point from the tangent plane, positive outside, 0 without depth;
    inside 0..1: how well the depth around continues that plane (0 at the object's outline and on what is not
    its surface); kind: see above.
    """

    which: Int32
    points: Float64
    normals: Float64
    cosine: Float64
    pixels: Float64
    offset: Float64
    inside: Float64
    kind: Int32


@jit
def empty_samples(count: int) -> Samples:
    """Buffers for `count` samples."""
    return Samples(
        np.empty(count, np.int32),
        np.empty((count, 3)),
        np.empty((count, 3)),
        np.empty(count),
        np.empty((count, 2)),
        np.empty(count),
        np.empty(count),
        np.empty(count, np.int32),
    )


@jit_dividing
def placed(
    T: Float64, surface: ModelArrays, i: int
) -> tuple[float, float, float, float, float, float, float]:
    """Sample i in camera axes: point, normal, and the cosine of its viewing angle (-1 behind the camera)."""
    s0, s1, s2 = surface.points[i, 0], surface.points[i, 1], surface.points[i, 2]
    m0, m1, m2 = surface.normals[i, 0], surface.normals[i, 1], surface.normals[i, 2]
    x = T[0, 0] * s0 + T[0, 1] * s1 + T[0, 2] * s2 + T[0, 3]
    y = T[1, 0] * s0 + T[1, 1] * s1 + T[1, 2] * s2 + T[1, 3]
    z = T[2, 0] * s0 + T[2, 1] * s1 + T[2, 2] * s2 + T[2, 3]
    n0 = T[0, 0] * m0 + T[0, 1] * m1 + T[0, 2] * m2
    n1 = T[1, 0] * m0 + T[1, 1] * m1 + T[1, 2] * m2
    n2 = T[2, 0] * m0 + T[2, 1] * m1 + T[2, 2] * m2
    if z < NEAREST_M:
        return x, y, z, n0, n1, n2, -1.0
    return x, y, z, n0, n1, n2, -(n0 * x + n1 * y + n2 * z) / np.sqrt(x * x + y * y + z * z)


@jit_dividing
def project(
    T: Float64,
    surface: ModelArrays,
    region: RegionArrays,
    limit: int,
    gate: float,
    reach: int,
    out: Samples,
) -> int:
    """Fill `out` with at most `limit` samples that the pose T shows; depth within `gate` metres of a sample's
    plane agrees with it, and four pixels `reach` away show whether it lies inside the object. Returns their
    number."""
    first, last = shown_range(T, surface, limit)
    depth = region.depth
    height, width = depth.shape
    fx, fy, cx, cy = region.fx, region.fy, region.cx, region.cy
    n = 0
    for k in range(first, last):
        i = surface.visible[k]
        x, y, z, n0, n1, n2, cosine = placed(T, surface, i)
        if cosine < MIN_COSINE:
            continue
        u, v = x / z * fx + cx, y / z * fy + cy
        out.which[n] = i
        out.points[n, 0], out.points[n, 1], out.points[n, 2] = x, y, z
        out.normals[n, 0], out.normals[n, 1], out.normals[n, 2] = n0, n1, n2
        out.cosine[n] = cosine
        out.pixels[n, 0], out.pixels[n, 1] = u, v
        out.offset[n] = out.inside[n] = 0.0
        column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
        if column < 0 or row < 0 or column >= width or row >= height:
            out.kind[n] = OUTSIDE
            n += 1
            continue
        seen = depth[row, column]
        if seen <= 0.0:
            out.kind[n] = NO_DEPTH
            n += 1
            continue
        # A reading is a point on its own pixel's ray, so there is no error from the rounded pixel.
        e = n0 * ((column - cx) / fx * seen - x) + n1 * ((row - cy) / fy * seen - y) + n2 * (seen - z)
        out.offset[n] = e
        if abs(e) < gate and abs(seen - z) < FAR_ALONG_RAY * gate:
            out.kind[n] = AGREES
            worst = 0.0
            for q in range(4):
                c = column + reach * ((q == 0) - (q == 1))
                r = row + reach * ((q == 2) - (q == 3))
                if c < 0 or r < 0 or c >= width or r >= height or depth[r, c] <= 0.0:
                    worst = gate
                    break
                d = depth[r, c]
                eq = n0 * ((c - cx) / fx * d - x) + n1 * ((r - cy) / fy * d - y) + n2 * (d - z)
                worst = max(worst, abs(eq - e))
            if worst < gate:
                out.inside[n] = (1.0 - (worst / gate) ** 2) ** 2
        else:
            out.kind[n] = BEHIND if seen > z else OCCLUDED
        n += 1
    return n


@jit_dividing
def colors(
    n: int,
    samples: Samples,
    region: RegionArrays,
    level: int,
    color: Float64,
    gradient: Float64,
    weight: Float64,
) -> int:
    """Bilinear colours (n, 3) at a scale and their slopes per pixel (n, 3, 2) at the samples that may be
    visible.

    Sets the weight of the others (outside the window, occluded, in free space, saturated) to 0. Returns how
    many are left.
    """
    image = region.colors[level]
    h, w = image.shape[0], image.shape[1]
    left = 0
    for k in range(n):
        if samples.kind[k] != AGREES and samples.kind[k] != NO_DEPTH:
            weight[k] = 0.0
            continue
        u, v = samples.pixels[k, 0], samples.pixels[k, 1]
        x0, y0 = int(np.floor(u)), int(np.floor(v))
        if x0 < 0 or y0 < 0 or x0 >= w - 1 or y0 >= h - 1:
            weight[k] = 0.0
            continue
        a, b = u - x0, v - y0
        if region.saturated[y0 + int(b + 0.5), x0 + int(a + 0.5)]:
            weight[k] = 0.0
            continue
        left += 1
        for c in range(3):
            p00, p01, p10, p11 = (
                image[y0, x0, c],
                image[y0, x0 + 1, c],
                image[y0 + 1, x0, c],
                image[y0 + 1, x0 + 1, c],
            )
            color[k, c] = (p00 * (1 - a) + p01 * a) * (1 - b) + (p10 * (1 - a) + p11 * a) * b
            gradient[k, c, 0] = (p01 - p00) * (1 - b) + (p11 - p10) * b
            gradient[k, c, 1] = (p10 - p00) * (1 - a) + (p11 - p01) * a
    return left
