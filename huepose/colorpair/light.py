"""The light of a picture as three gains, and colours as they would be under another light.

Exposure and the colour of the light multiply XYZ, each channel by its own factor, in good approximation.
CIELAB is linear in the cube roots of XYZ (but for the darkest colours), so light multiplies those cube
roots too, by the cube roots of the factors: the `gain` here. It is estimated on cube roots and applied to
them.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64


def cube_roots(lab: Float) -> Float64:
    """Cube roots of relative X, Y, Z (..., 3), white = 1, of CIELAB colours (..., 3)."""
    c = np.asarray(lab, np.float64)
    y = (c[..., 0] + 16.0) / 116.0
    return np.stack([y + c[..., 1] / 500.0, y, y - c[..., 2] / 200.0], -1)


def lab_of(roots: Float) -> Float32:
    """CIELAB (..., 3) float32 of cube roots of X, Y, Z (..., 3); inverse of `cube_roots`."""
    r = np.asarray(roots, np.float64)
    x, y, z = r[..., 0], r[..., 1], r[..., 2]
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], -1).astype(np.float32)


def relit(lab: Float, gain: Float) -> Float32:
    """Colours (..., 3) CIELAB under a light that is `gain` (3,) times as strong (in cube roots of X, Y, Z).

    `relit(relit(c, g), 1 / g)` is `c`.
    """
    return lab_of(cube_roots(lab) * np.asarray(gain, np.float64))
