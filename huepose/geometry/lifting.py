"""Lifts pixels to 3D. Depth is never averaged across an occlusion edge."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool, Float, Float32, Float64
from huepose.geometry.camera import Camera

EDGE_M = 0.006
EDGE_SHARE = 0.012
"""Neighbouring readings belong to two surfaces if they differ by more than EDGE_M plus EDGE_SHARE of the
distance."""


def lift(depth: Float32, camera: Camera, pixels: Float) -> tuple[Float64, Bool]:
    """Points (N, 3), camera axes, of pixels (N, 2) of a depth image (H, W), and which are known (N,).

    Depth is interpolated bilinearly if the four readings around a pixel belong to one surface. At an edge
    the nearest reading is taken if one other of the four agrees with it. In all other cases, also outside
    the image, the point is unknown.
    """
    p = np.asarray(pixels, np.float64)
    height, width = depth.shape
    u, v = p[:, 0], p[:, 1]
    inside = np.isfinite(p).all(1) & (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
    x0, y0 = np.minimum(u.astype(int), width - 2), np.minimum(v.astype(int), height - 2)
    a, b = u - x0, v - y0
    corners = np.stack([depth[y0, x0], depth[y0, x0 + 1], depth[y0 + 1, x0], depth[y0 + 1, x0 + 1]], 1)
    corners = np.where(np.isfinite(corners), corners, 0.0).astype(np.float64)
    shares = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], 1)
    nearest = np.take_along_axis(corners, shares.argmax(1)[:, None], 1)[:, 0]
    agree = (corners > 0) & (np.abs(corners - nearest[:, None]) < EDGE_M + EDGE_SHARE * nearest[:, None])
    one_surface = agree.all(1)
    z = np.where(one_surface, (corners * shares).sum(1), nearest)
    known = inside & (nearest > 0) & (agree.sum(1) >= 2)
    # A reading that is not interpolated is a point on the ray of its own pixel.
    at = np.stack([x0 + (shares.argmax(1) % 2), y0 + shares.argmax(1) // 2], 1)
    points = camera.backproject(np.where(one_surface[:, None], p, at), np.where(known, z, 0.0))
    return np.where(known[:, None], points, 0.0), known
