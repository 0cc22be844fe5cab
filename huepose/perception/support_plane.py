"""The plane that things stand on: found in a ring round an object's box, so that it can be taken away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.support.jit import jit

RING_GROWTH, RING_PIXELS = 0.6, 15.0
"""The ring reaches 60 % of the box's size and 15 pixels beyond it."""

POINTS, TRIALS = 1500, 150
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
    v, u = (g.ravel() for g in np.mgrid[rows.start : rows.stop : 2, columns.start : columns.stop : 2])
    inside = (u > box.x) & (u < box.x1) & (v > box.y) & (v < box.y1)
    z = depth[v, u]
    keep = np.flatnonzero(~inside & (z > 0))
    if len(keep) < 50:
        return None
    rng = np.random.default_rng(0)
    keep = rng.permutation(keep)[:POINTS]
    points = camera.backproject(np.stack([u[keep], v[keep]], -1), z[keep])
    best = best_plane(points, rng.integers(0, len(points), (TRIALS, 3)))
    if best[0] < MIN_SHARE * len(points):
        return None
    normal, point = best[1:4], best[4:7]
    for _ in range(3):
        near = points[np.abs((points - point) @ normal) < 0.008]
        if len(near) < 3:
            return None
        point = near.mean(0)
        normal = np.linalg.svd(near - point, full_matrices=False)[2][2]
    return Plane(normal * -np.sign(normal @ point), point)


@jit
def best_plane(points: Float64, triples: np.ndarray) -> Float64:
    """Count, normal, point of the plane through one of the triples that has most points near it; what is near
    grows with the square of depth, as the noise of stereo does."""
    best = np.zeros(7)
    n = np.empty(3)
    for i in range(triples.shape[0]):
        a, b, c = points[triples[i, 0]], points[triples[i, 1]], points[triples[i, 2]]
        x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        y0, y1, y2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        n[0], n[1], n[2] = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
        length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if length < 1e-9:
            continue
        count = 0
        for k in range(points.shape[0]):
            p = points[k]
            height = ((p[0] - a[0]) * n[0] + (p[1] - a[1]) * n[1] + (p[2] - a[2]) * n[2]) / length
            z = max(p[2], 0.5)
            if abs(height) < 0.006 * z * z:
                count += 1
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
