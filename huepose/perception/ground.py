"""What no object can be: planes larger than any of them, such as tables, floors and walls."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.camera import Camera
from huepose.perception.support_plane import Plane, best_plane

POINTS, TRIALS, MOST = 1500, 120, 3
MIN_SHARE = 0.06
"""A plane that holds less of the points that are left is not looked for."""

NEAR_M, REFITS = 0.008, 3
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
    u = (np.arange(depth.shape[1], dtype=np.float32) - np.float32(camera.cx)) / np.float32(camera.fx)
    v = (np.arange(depth.shape[0], dtype=np.float32) - np.float32(camera.cy)) / np.float32(camera.fy)
    band = np.float32(BAND_M) + np.float32(BAND_PER_M) * depth * depth
    for plane in planes:
        n, offset = plane.normal.astype(np.float32), np.float32(plane.point @ plane.normal)
        # The normal points to the camera: what is in front of the plane has more height.
        height = depth * ((u * n[0])[None, :] + (v * n[1])[:, None] + n[2]) - offset
        on = clear & (np.abs(height) <= band)
        # A pixel sees z^3 / (fx fy |offset|) of a plane.
        area = depth * depth * depth * on * np.float32(1.0 / (camera.fx * camera.fy * abs(offset)))
        bounds = (height > BEYOND * band) * 1.0 - (height < -BEYOND * band)
        bounds[on | ~clear] = 1.0
        clear &= ~_pieces_of(on, area, bounds, depth > 0, larger_than_m2)
    return np.asarray(clear)


def _pieces_of(on: Bool, area: Float32, bounds: Float64, known: Bool, larger_than_m2: float) -> Bool:
    """Which pixels (H, W) on a plane are of its large pieces, or of small ones that what is `known` beside
    them bounds, by the mean of `bounds` there; area (H, W): that a pixel sees, 0 where it is not `on` it."""
    count, labels = cv2.connectedComponents(on.view(np.uint8), connectivity=4)
    small = np.bincount(labels.ravel(), area.ravel(), count) < larger_than_m2
    small[0] = False
    v, u = np.nonzero(small[labels])
    own = labels[v, u]
    seen, bounded = np.zeros(count), np.zeros(count)
    for down, right in ((0, BESIDE_PX), (0, -BESIDE_PX), (BESIDE_PX, 0), (-BESIDE_PX, 0)):
        b, a = v + down, u + right
        within = (b >= 0) & (a >= 0) & (b < on.shape[0]) & (a < on.shape[1])
        b, a, mine = b[within], a[within], own[within]
        other = (labels[b, a] != mine) & known[b, a]
        seen += np.bincount(mine[other], minlength=count)
        bounded += np.bincount(mine[other], bounds[b, a][other], count)
    kept = ~small | (bounded >= BOUNDED * seen)
    kept[0] = False
    return np.asarray(kept[labels])


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
