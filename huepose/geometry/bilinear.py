"""Bilinear interpolation of an image."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float64, UInt8


def bilinear(image: Float | UInt8, u: Float64, v: Float64) -> Float64:
    """Values (N, C) of an image (H, W, C) at columns u (N,) and rows v (N,); outside, the border value.

    >>> bilinear(np.array([[[0.0], [4.0]], [[2.0], [6.0]]]), np.array([0.25, 9.0]), np.array([0.5, -1.0])).T
    array([[2., 4.]])
    """
    height, width = image.shape[:2]
    u0 = np.clip(u.astype(np.int64), 0, width - 2)
    v0 = np.clip(v.astype(np.int64), 0, height - 2)
    a, b = np.clip(u - u0, 0.0, 1.0)[:, None], np.clip(v - v0, 0.0, 1.0)[:, None]
    upper = (1.0 - a) * image[v0, u0] + a * image[v0, u0 + 1]
    lower = (1.0 - a) * image[v0 + 1, u0] + a * image[v0 + 1, u0 + 1]
    return np.asarray((1.0 - b) * upper + b * lower, dtype=np.float64)
