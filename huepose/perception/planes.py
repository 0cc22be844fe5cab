"""Planes in a frame's depth, by RANSAC (Fischler and Bolles, 1981): the plane that an object stands on, in
a ring around its box; and planes larger than any object, such as tables, floors and walls, which are
removed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry.arrays import NORMAL_MAD, Bool, Float32, Float64, Int8, Int64, UInt8
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.perception.stretches import connected
from huepose.support.jit import jit, jit_dividing

RING_GROWTH, RING_PIXELS = 0.6, 15.0
"""The ring reaches 60 % of the box's size and 15 pixels beyond the box."""

POINTS = 1500
"""Most depth readings that RANSAC uses."""

RING_TRIALS, LARGE_TRIALS = 150, 500
"""Triples of readings that RANSAC draws, in the ring and in the whole image. The latter contain a triple in
a plane of a fifth of the readings with a probability of 98 %."""

NEAR_M = 0.008
"""Points within this distance of a plane belong to it, metres."""

MIN_RING_SHARE, MIN_SHARE = 0.25, 0.06
"""Least share of the ring's readings in a support plane, and of the image's readings in a large plane."""

MOST = 5
"""Most large planes of an image: a table, the floor, walls."""

NOISIEST, NOISIER, QUIET = 0.0062, 3.0, 0.003
"""A large plane has at most the noise NOISIEST, and at most NOISIER times that of the least noisy plane, or
QUIET if that is more: noise is the camera's. Readings that spread wider lie on several surfaces. Readings
spread evenly within the reach of a fit have 0.0089."""

REFITS = 3
"""Least-squares fits of a plane, each to the points near the one before."""

BAND_M, BAND_PER_M = 0.004, 0.004
BEYOND = 2.0
"""Depth z lies on a plane within BAND_M + BAND_PER_M * z^2 of it (metres). Farther off than BEYOND times
that, it lies in front of the plane or behind it."""

NOISE_SIGMAS = 2.0
"""Depth within this many standard deviations of a plane's own noise lies on it, too: far walls are
noisy."""

IN_FRONT, UNDER, BELOW = 1, -1, -2
"""Depth relative to a plane: in front of it, behind it by less than the diameter of the largest object, and
farther behind."""

TOP = 0.5
"""A large piece of a plane is the top of objects that lie side by side if, at more than this share of its
edge, depth falls UNDER it, to what they lie on. At a table's edge depth falls farther, or not at all."""

SOME = 4
"""In a large piece, what is beside a pixel is checked for every fourth pixel of a row, to save time."""

BESIDE_PX, BOUNDED = 3, 0.25
"""A small piece of a plane is removed with it if, of the pixels BESIDE_PX away, more are in front of the
plane or on a plane than behind it, by at least the share BOUNDED. Extended, the floor also cuts through
what stands on a table, and a table through the bottom of a bowl; there the surface goes on beside the
plane, or crosses it."""


@dataclass(frozen=True, eq=False)
class Plane:
    """normal (3,): unit, towards the camera; point (3,): on the plane. Camera axes, metres. noise: standard
    deviation of the readings about it, metres per square metre of depth squared."""

    normal: Float64
    point: Float64
    noise: float = 0.0

    def height(self, points_cam: Float64) -> Float64:
        """Signed distance (...,) of points (..., 3) above the plane, towards the camera."""
        return np.asarray((points_cam - self.point) @ self.normal)


def find_support_plane(depth: Float32, camera: Camera, box: Box) -> Plane | None:
    """The largest plane in the depth (H, W) around a box, by RANSAC and three refits; None if no plane
    holds a quarter of the readings there. Deterministic."""
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
    best = _best_plane(points, rng.integers(0, len(points), (RING_TRIALS, 3)))
    if best[0] < MIN_RING_SHARE * len(points):
        return None
    normal, point = best[1:4], best[4:7]
    for _ in range(REFITS):
        near, point, spread = _near_plane(points, normal, point)
        if near < 3:
            return None
        normal = np.linalg.eigh(spread)[1][:, 0]
    return Plane(normal * -np.sign(normal @ point), point)


@jit
def _outside(ring: Float32, left: float, top: float, right: float, bottom: float) -> Int64:
    """Indices (N,), row by row, of the readings outside a box. ring (h, w): every second pixel of a window;
    the box is in full-resolution pixels of the window."""
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
    """How many points (N, 3) lie within NEAR_M of a plane, their mean (3,), and the lower triangle of their
    scatter matrix (3, 3), not divided by their number."""
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


def above_plane(depth: Float32, camera: Camera, plane: Plane | None) -> Bool:
    """Pixels (H, W) with depth that are clearly above the plane; without a plane, all with depth."""
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


def large_planes(depth: Float32, camera: Camera, larger_than_m2: float) -> list[Plane]:
    """Planes in a depth image (H, W) whose visible area is more than `larger_than_m2`, the largest first.

    RANSAC on a sparse lattice, one plane after the other. Deterministic.
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
        best = _best_plane(points, rng.integers(0, len(points), (LARGE_TRIALS, 3)))
        if best[0] < MIN_SHARE * total:
            break
        plane, near = _refitted(points, Plane(best[1:4], best[4:7]))
        least = min((p.noise for p in planes), default=NOISIEST)
        too_noisy = plane.noise > min(NOISIEST, max(NOISIER * least, QUIET))
        if not too_noisy and each * _area(points[near], plane) > larger_than_m2:
            planes.append(plane)
        points = points[~near]
    return planes


def standing_clear(depth: Float32, camera: Camera, planes: Sequence[Plane], largest_m: float) -> Bool:
    """Pixels (H, W) with depth that lie on none of the planes.

    Of a plane, pieces larger than the square of the largest object's diameter are removed, and pieces that
    are visible between things standing on it. Not removed are the tops of objects side by side, at whose
    edges depth falls by less than that diameter."""
    clear = depth > 0
    on, side = np.empty(depth.shape, np.uint8), np.empty(depth.shape, np.int8)
    for plane in planes:
        n, offset = plane.normal, float(plane.point @ plane.normal)
        rows = np.array([n[0] / camera.fx, n[1] / camera.fy, n[2]])
        rows[2] -= rows[0] * camera.cx + rows[1] * camera.cy
        _classify(depth, clear, rows, offset, NOISE_SIGMAS * plane.noise, largest_m, on, side)
        # A pixel at depth z covers the area z^3 / (fx fy |offset|) of a plane.
        _remove_pieces(on, depth, side, largest_m**2 * camera.fx * camera.fy * abs(offset), clear)
    return np.asarray(clear)


@jit_dividing
def _classify(
    depth: Float32,
    clear: Bool,
    rows: Float64,
    offset: float,
    noise_per_m: float,
    reach_m: float,
    on: UInt8,
    side: Int8,
) -> None:
    """Fill two images (H, W) that describe a plane. on: 1 where a clear pixel lies on it, else 0. side,
    also for pixels that were removed before: IN_FRONT of it, UNDER it by less than `reach_m`, or BELOW
    that; 0 on it, near it or without depth.

    rows (3,): the product of a pixel's ray with the normal is rows @ (u, v, 1); noise_per_m: noise within
    which depth lies on the plane, metres per square metre of depth squared."""
    right = np.float32(rows[0])
    for v in range(depth.shape[0]):
        first = np.float32(rows[1] * v + rows[2])
        for u in range(depth.shape[1]):
            z = depth[v, u]
            # The normal points to the camera, so height is positive in front of the plane.
            height = z * (right * np.float32(u) + first) - np.float32(offset)
            square = z * z
            usual = np.float32(BAND_M) + np.float32(BAND_PER_M) * square
            band = max(usual, np.float32(noise_per_m) * square)
            on[v, u] = clear[v, u] and abs(height) <= band
            if z <= 0.0 or abs(height) <= np.float32(BEYOND) * band:
                side[v, u] = 0
            elif height > 0.0:
                side[v, u] = IN_FRONT
            else:
                side[v, u] = UNDER if height > -reach_m else BELOW


@jit
def _remove_pieces(on: UInt8, depth: Float32, side: Int8, larger_than: float, clear: Bool) -> None:
    """Set `clear` to False on connected pieces of a plane (`on`). Large pieces, by the sum of their depth
    cubed, are removed unless most of their edge lies a little above what is beside it. Small pieces are
    removed if, of the pixels with depth beside them, clearly more are in front of the plane, on it or
    removed before than behind it."""
    height, width = on.shape
    stretches, count = connected(on)
    size, beside, with_depth, bounded, falls = np.zeros((5, count))
    pieces = np.full(on.shape, -1, np.int32)
    for v, first, last, piece in stretches:
        pieces[v, first:last] = piece
        for u in range(first, last):
            size[piece] += depth[v, u] ** 3
    for v, first, last, piece in stretches:
        for u in range(first, last, 1 if size[piece] < larger_than else SOME):
            for q in range(4):
                b, a = v + BESIDE_PX * ((q == 0) - (q == 1)), u + BESIDE_PX * ((q == 2) - (q == 3))
                if not (0 <= b < height and 0 <= a < width):
                    beside[piece] += 1.0
                elif pieces[b, a] != piece and depth[b, a] > 0.0:
                    with_depth[piece] += 1.0
                    again = on[b, a] or not clear[b, a]
                    bounded[piece] += 1.0 if again else np.sign(side[b, a])
                    beside[piece] += side[b, a] != 0
                    falls[piece] += side[b, a] == UNDER
    for v, first, last, piece in stretches:
        if size[piece] >= larger_than:
            taken = falls[piece] <= TOP * beside[piece]
        else:
            taken = bounded[piece] >= BOUNDED * with_depth[piece]
        if taken:
            clear[v, first:last] = False


def _refitted(points: Float64, plane: Plane) -> tuple[Plane, Bool]:
    """The plane fitted to the points near it, and which points (N,) these are. Each point is weighted by
    the inverse of its variance, since depth noise grows with the square of depth: otherwise a far wall that
    the plane cuts would tilt it."""
    near = _near(points, plane)
    for _ in range(REFITS):
        if near.sum() < 3:
            break
        weights = np.maximum(points[near, 2], 0.5) ** -4.0
        middle = weights @ points[near] / weights.sum()
        rows = (points[near] - middle) * np.sqrt(weights)[:, None]
        normal = np.linalg.svd(rows, full_matrices=False)[2][2]
        plane = Plane(normal * -np.sign(normal @ middle), middle)
        near = _near(points, plane)
    off = np.abs(plane.height(points[near])) / np.maximum(points[near, 2], 0.5) ** 2
    return replace(plane, noise=NORMAL_MAD * float(np.median(off)) if len(off) else 0.0), near


def _near(points: Float64, plane: Plane) -> Bool:
    return np.asarray(np.abs(plane.height(points)) < NEAR_M * np.maximum(points[:, 2], 0.5) ** 2 * 1.5)


def _area(points: Float64, plane: Plane) -> float:
    """Area of a plane that the pixels at points (N, 3) cover, for a focal length of one pixel."""
    slant = np.abs(points @ plane.normal) / np.linalg.norm(points, axis=1)
    return float((points[:, 2] ** 2 / np.maximum(slant, 0.1)).sum())


@jit
def _best_plane(points: Float64, triples: np.ndarray) -> Float64:
    """Count, normal and point of the plane through one of the triples that has most points near it. The
    tolerance grows with the square of depth, as the noise of stereo does."""
    best = np.zeros(7)
    n = np.empty(3)
    # One array per coordinate, so that the compiler vectorises the loop.
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
