"""What no object can be: planes larger than any of them, such as tables, floors and walls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int8, UInt8
from huepose.geometry.camera import Camera
from huepose.perception.stretches import connected
from huepose.perception.support_plane import NEAR_M, POINTS, Plane, best_plane
from huepose.support.jit import jit, jit_dividing

TRIALS, MOST = 120, 3
"""Triples of points that RANSAC draws for a plane, and most planes of a frame."""

MIN_SHARE = 0.06
"""A plane that holds less of the points that are left is not looked for."""

REFITS = 3
"""Least-squares fits of a plane, each to the points near the one before."""

BAND_M, BAND_PER_M = 0.004, 0.004
BEYOND = 2.0
"""Depth this near to a plane, and so much more per square metre of depth squared, lies on it; what is more
than so many times as far off stands in front of it."""

BESIDE_PX, BOUNDED = 3, 0.25
"""A small piece of a plane is the plane's where, of what is so far beside it, so much more stands in front of
it or is the plane again than lies behind it. The floor, continued, also cuts through what stands on a table,
and a table through the bottom of a bowl; there the surface goes on beside it, or crosses it."""


def large_planes(depth: Float32, camera: Camera, larger_than_m2: float) -> list[Plane]:
    """Planes of a picture's depth (H, W) of which more than `larger_than_m2` is seen, the largest first.

    By RANSAC on a sparse lattice, one plane after the other; the same picture always gives the same planes.
    """
    step = max(2, round(np.sqrt(depth.size / (3 * POINTS))))
    v, u = (g.ravel() for g in np.mgrid[step // 2 : depth.shape[0] : step, step // 2 : depth.shape[1] : step])
    z = depth[v, u]
    known = z > 0
    points = camera.backproject(np.stack([u[known], v[known]], -1), z[known])
    rng = np.random.default_rng(0)
    points = points[rng.permutation(len(points))[:POINTS]]
    total = len(points)
    each = step * step * known.sum() / max(total, 1) / (camera.fx * camera.fy)
    planes: list[Plane] = []
    while len(planes) < MOST and len(points) > MIN_SHARE * total + 3:
        best = best_plane(points, rng.integers(0, len(points), (TRIALS, 3)))
        if best[0] < MIN_SHARE * total:
            break
        plane, near = _refitted(points, Plane(best[1:4], best[4:7]))
        if each * _area(points[near], plane) > larger_than_m2:
            planes.append(plane)
        points = points[~near]
    return planes


def standing_clear(depth: Float32, camera: Camera, planes: Sequence[Plane], larger_than_m2: float) -> Bool:
    """Pixels (H, W) with depth that lie on none of the planes. Of a plane those pieces count that are larger
    than `larger_than_m2`, and what of it is seen between things that stand on it."""
    clear = depth > 0
    on, front = np.empty(depth.shape, np.uint8), np.empty(depth.shape, np.int8)
    for plane in planes:
        n, offset = plane.normal, float(plane.point @ plane.normal)
        rows = np.array([n[0] / camera.fx, n[1] / camera.fy, n[2]])
        rows[2] -= rows[0] * camera.cx + rows[1] * camera.cy
        _sorted(depth, clear, rows, offset, on, front)
        # A pixel sees z^3 / (fx fy |offset|) of a plane.
        _take_away(on, depth, front, larger_than_m2 * camera.fx * camera.fy * abs(offset), clear)
    return np.asarray(clear)


@jit_dividing
def _sorted(depth: Float32, clear: Bool, rows: Float64, offset: float, on: UInt8, front: Int8) -> None:
    """Fill `on` (H, W) with 1 where what is clear lies on a plane, else 0; `front` (H, W) with 1 on it, in
    front of it and where planes before took what is there, -1 behind it, 0 between. rows (3,): the product of
    a pixel's ray with the normal is rows @ (u, v, 1)."""
    right = np.float32(rows[0])
    for v in range(depth.shape[0]):
        first = np.float32(rows[1] * v + rows[2])
        for u in range(depth.shape[1]):
            z = depth[v, u]
            # The normal points to the camera: what is in front of the plane has more height.
            height = z * (right * np.float32(u) + first) - np.float32(offset)
            band = np.float32(BAND_M) + np.float32(BAND_PER_M) * z * z
            on[v, u] = clear[v, u] and abs(height) <= band
            if on[v, u] or not clear[v, u]:
                front[v, u] = 1
            else:
                beyond = np.float32(BEYOND) * band
                front[v, u] = np.int8(height > beyond) - np.int8(height < -beyond)


@jit
def _take_away(on: UInt8, depth: Float32, front: Int8, larger_than: float, clear: Bool) -> None:
    """Clear away the connected pieces of a plane (`on`) that are large (their sums of depth cubed), or that
    what has depth beside them bounds, by the mean of `front` there."""
    height, width = on.shape
    stretches, count = connected(on)
    size, seen, bounded = np.zeros((3, count))
    pieces = np.full(on.shape, -1, np.int32)
    for v, first, last, piece in stretches:
        pieces[v, first:last] = piece
        for u in range(first, last):
            size[piece] += depth[v, u] ** 3
    for v, first, last, piece in stretches:
        if size[piece] >= larger_than:
            continue
        for u in range(first, last):
            for q in range(4):
                b, a = v + BESIDE_PX * ((q == 0) - (q == 1)), u + BESIDE_PX * ((q == 2) - (q == 3))
                if 0 <= b < height and 0 <= a < width and pieces[b, a] != piece and depth[b, a] > 0.0:
                    seen[piece] += 1.0
                    bounded[piece] += front[b, a]
    for v, first, last, piece in stretches:
        if size[piece] >= larger_than or bounded[piece] >= BOUNDED * seen[piece]:
            clear[v, first:last] = False


def _refitted(points: Float64, plane: Plane) -> tuple[Plane, Bool]:
    """The plane fitted to the points near it, and which points (N,) these are."""
    near = _near(points, plane)
    for _ in range(REFITS):
        if near.sum() < 3:
            break
        middle = points[near].mean(0)
        normal = np.linalg.svd(points[near] - middle, full_matrices=False)[2][2]
        plane = Plane(normal * -np.sign(normal @ middle), middle)
        near = _near(points, plane)
    return plane, near


def _near(points: Float64, plane: Plane) -> Bool:
    return np.asarray(np.abs(plane.height(points)) < NEAR_M * np.maximum(points[:, 2], 0.5) ** 2 * 1.5)


def _area(points: Float64, plane: Plane) -> float:
    """Area of a plane seen in pixels of unit focal length at points (N, 3)."""
    slant = np.abs(points @ plane.normal) / np.linalg.norm(points, axis=1)
    return float((points[:, 2] ** 2 / np.maximum(slant, 0.1)).sum())
