"""The plane that things stand on: found in a ring round an object's box, so that it can be taken away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int64
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.support.jit import jit

RING_GROWTH, RING_PIXELS = 0.6, 15.0
"""The ring reaches 60 % of the box's size and 15 pixels beyond it."""

POINTS, TRIALS = 1500, 150
"""Most readings of the ring that are looked at, and triples of them that RANSAC draws."""

NEAR_M = 0.008
"""Points within this of a plane are its."""

MIN_SHARE = 0.25
"""A plane that holds less than a quarter of the ring is no support."""


@dataclass(frozen=True, eq=False)
class Plane:
    """normal (3,): unit, towards the camera; point (3,): on the plane. Camera axes, metres."""

    normal: Float64
    point: Float64

    def height(self, points_cam: Float64) -> Float64:
        """Signed distance (...,) of points (..., 3) above the plane, towards the camera."""
        return np.asarray((points_cam - self.point) @ self.normal)


def find_support_plane(depth: Float32, camera: Camera, box: Box) -> Plane | None:
    """The largest plane in the depth (H, W) round a box by RANSAC and three refits; None when no plane holds
    a quarter of it. The same picture always gives the same plane."""
    window = box.grown(RING_GROWTH, RING_PIXELS)
    rows, columns = window.slices(camera.width, camera.height)
    ring = np.ascontiguousarray(depth[rows, columns][::2, ::2])
    wide = ring.shape[1]
    left, right = float(box.x - columns.start), float(box.x1 - columns.start)
    top, bottom = float(box.y - rows.start), float(box.y1 - rows.start)
    keep = _outside(ring, left, top, right, bottom)
    if len(keep) < 50:
        return None
    rng = np.random.default_rng(0)
    keep = rng.permutation(keep)[:POINTS]
    down, across = np.divmod(keep, wide)
    pixels = np.stack([columns.start + 2 * across, rows.start + 2 * down], -1)
    points = camera.backproject(pixels, ring[down, across])
    best = best_plane(points, rng.integers(0, len(points), (TRIALS, 3)))
    if best[0] < MIN_SHARE * len(points):
        return None
    normal, point = best[1:4], best[4:7]
    for _ in range(3):
        near, point, spread = _near_plane(points, normal, point)
        if near < 3:
            return None
        normal = np.linalg.eigh(spread)[1][:, 0]
    return Plane(normal * -np.sign(normal @ point), point)


@jit
def _outside(ring: Float32, left: float, top: float, right: float, bottom: float) -> Int64:
    """Places (N,), row by row, of the readings of every second pixel (h, w) of a window that do not lie in a
    box, which is given in all of its pixels."""
    out = np.empty(ring.size, np.int64)
    count = 0
    for v in range(ring.shape[0]):
        beside = not (top < 2 * v < bottom)
        for u in range(ring.shape[1]):
            if ring[v, u] > 0.0 and (beside or not (left < 2 * u < right)):
                out[count] = v * ring.shape[1] + u
                count += 1
    return out[:count]


@jit
def _near_plane(points: Float64, normal: Float64, point: Float64) -> tuple[int, Float64, Float64]:
    """How many points (N, 3) lie within NEAR_M of a plane, their mean (3,) and their spread about it (3, 3),
    not divided."""
    count, mean, spread = 0, np.zeros(3), np.zeros((3, 3))
    rows = np.empty((points.shape[0], 3))
    for k in range(points.shape[0]):
        height = 0.0
        for r in range(3):
            height += (points[k, r] - point[r]) * normal[r]
        if abs(height) < NEAR_M:
            for r in range(3):
                rows[count, r] = points[k, r]
                mean[r] += points[k, r]
            count += 1
    for r in range(3):
        mean[r] /= max(count, 1)
    for k in range(count):
        d0, d1, d2 = rows[k, 0] - mean[0], rows[k, 1] - mean[1], rows[k, 2] - mean[2]
        spread[0, 0] += d0 * d0
        spread[1, 1] += d1 * d1
        spread[2, 2] += d2 * d2
        spread[1, 0] += d1 * d0
        spread[2, 0] += d2 * d0
        spread[2, 1] += d2 * d1
    return count, mean, spread


@jit
def best_plane(points: Float64, triples: np.ndarray) -> Float64:
    """Count, normal, point of the plane through one of the triples that has most points near it; what is near
    grows with the square of depth, as the noise of stereo does."""
    best = np.zeros(7)
    n = np.empty(3)
    # Coordinate by coordinate, so that the compiler works on several points at once.
    x, y, z, near = np.empty((4, points.shape[0]))
    for k in range(points.shape[0]):
        x[k], y[k], z[k] = points[k, 0], points[k, 1], points[k, 2]
        deep = max(z[k], 0.5)
        near[k] = 0.006 * deep * deep
    for i in range(triples.shape[0]):
        a, b, c = points[triples[i, 0]], points[triples[i, 1]], points[triples[i, 2]]
        x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        y0, y1, y2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        n[0], n[1], n[2] = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
        length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if length < 1e-9:
            continue
        n0, n1, n2, a0, a1, a2 = n[0] / length, n[1] / length, n[2] / length, a[0], a[1], a[2]
        count = 0
        for k in range(points.shape[0]):
            height = (x[k] - a0) * n0 + (y[k] - a1) * n1 + (z[k] - a2) * n2
            count += 1 if abs(height) < near[k] else 0
        if count > best[0]:
            best[0] = count
            for r in range(3):
                best[1 + r], best[4 + r] = n[r] / length, a[r]
    return best


def above_plane(depth: Float32, camera: Camera, plane: Plane | None) -> Bool:
    """Pixels (H, W) with depth that stand clear of the plane (all with depth, without one)."""
    valid = depth > 0
    if plane is None:
        return valid
    # Height of a pixel: z (ray . n) - point . n, with the ray linear in the pixel.
    n = plane.normal
    u = (np.arange(depth.shape[1], dtype=np.float32) - np.float32(camera.cx)) * np.float32(n[0] / camera.fx)
    v = (np.arange(depth.shape[0], dtype=np.float32) - np.float32(camera.cy)) * np.float32(n[1] / camera.fy)
    slope = u[None, :] + v[:, None] + np.float32(n[2])
    height = depth * slope - np.float32(plane.point @ n)
    return np.asarray(valid & (height > 0.004 + 0.003 * depth * depth))
