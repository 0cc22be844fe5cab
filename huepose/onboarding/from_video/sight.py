"""Compiled kernels: project points of the object into a view and compare them with its depth."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int64
from huepose.geometry.camera import FLOOR_M, NEAREST_M, STEREO_NOISE_PER_M
from huepose.support.jit import jit

SIGMAS = 3.0
"""Readings within this many standard errors may belong to one surface."""

THERE, THROUGH, OTHER, BEHIND, BENEATH = range(5)


@jit
def _cam(p: Float64, T: Float64) -> tuple[float, float, float]:
    """A point in camera axes."""
    return (
        T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3],
        T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3],
        T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3],
    )


@jit
def _pixel(x: float, y: float, z: float, k: Float64, height: int, width: int) -> tuple[int, int]:
    """Row and column of a point; -1 outside. k: fx, fy, cx, cy."""
    if z <= NEAREST_M:
        return -1, -1
    column, row = np.rint(x / z * k[0] + k[2]), np.rint(y / z * k[1] + k[3])
    if column < 0 or row < 0 or column >= width or row >= height:
        return -1, -1
    return int(row), int(column)


@jit
def _slack(z: float) -> float:
    return SIGMAS * (FLOOR_M + STEREO_NOISE_PER_M * z * z)


@jit
def tally(
    points_obj: Float64,
    T_cam_obj: Float64,
    k: Float64,
    depth: Float32,
    mask: Bool,
    outer: Bool,
    nearest: Float32,
    ground: Float64,
    counts: Int64,
) -> None:
    """Add the votes of a view on points (N, 3) to `counts` (N, 5): see `views.Votes`. ground (4,): zeros if
    the view shows none."""
    height, width = depth.shape
    for i in range(len(points_obj)):
        x, y, z = _cam(points_obj[i], T_cam_obj)
        if ground[0] * x + ground[1] * y + ground[2] * z + ground[3] < 0:
            counts[i, BENEATH] += 1
        row, column = _pixel(x, y, z, k, height, width)
        if row < 0:
            continue
        slack = _slack(z)
        if nearest[row, column] > z + slack:
            counts[i, THROUGH] += 1
        reading = depth[row, column]
        if reading <= 0:
            continue
        if abs(reading - z) <= slack:
            counts[i, THERE] += mask[row, column]
            counts[i, OTHER] += outer[row, column]
        elif z > reading:
            counts[i, BEHIND] += mask[row, column]


@jit
def seen_more_squarely(
    points_obj: Float64,
    normals_obj: Float64,
    T_cam_obj: Float64,
    k: Float64,
    depth: Float32,
    inner: Bool,
    best: Float64,
    more: float,
) -> Int64:
    """Rows and columns (N, 2) of points whose cosine of the viewing angle in this view is larger than
    `best` (N,) by `more`, and set `best` to it; -1 for the others."""
    height, width = depth.shape
    out = np.full((len(points_obj), 2), -1, np.int64)
    for i in range(len(points_obj)):
        x, y, z = _cam(points_obj[i], T_cam_obj)
        row, column = _pixel(x, y, z, k, height, width)
        if row < 0 or not inner[row, column] or abs(depth[row, column] - z) >= _slack(z):
            continue
        n, T = normals_obj[i], T_cam_obj
        facing = 0.0
        for axis in range(3):
            facing -= n[axis] * (T[0, axis] * x + T[1, axis] * y + T[2, axis] * z)
        if facing / z > best[i] + more:
            best[i] = facing / z
            out[i, 0], out[i, 1] = row, column
    return out
