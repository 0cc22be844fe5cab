"""Bilinear interpolation of an image."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float64, UInt8
from huepose.support.jit import jit


def bilinear(image: Float | UInt8, u: Float64, v: Float64) -> Float64:
    """Values (N, C) of an image (H, W, C) at columns u (N,) and rows v (N,); outside, the border value.

    >>> bilinear(np.array([[[0.0], [4.0]], [[2.0], [6.0]]]), np.array([0.25, 9.0]), np.array([0.5, -1.0])).T
    array([[2., 4.]])
    """
    out = np.empty((len(u), image.shape[2]))
    _interpolate(image, u, v, out)
    return out


@jit
def _interpolate(image: Float | UInt8, u: Float64, v: Float64, out: Float64) -> None:
    height, width = image.shape[:2]
    for k in range(out.shape[0]):
        column, row = min(max(int(u[k]), 0), width - 2), min(max(int(v[k]), 0), height - 2)
        a, b = min(max(u[k] - column, 0.0), 1.0), min(max(v[k] - row, 0.0), 1.0)
        for c in range(out.shape[1]):
            upper = (1.0 - a) * image[row, column, c] + a * image[row, column + 1, c]
            lower = (1.0 - a) * image[row + 1, column, c] + a * image[row + 1, column + 1, c]
            out[k, c] = (1.0 - b) * upper + b * lower
