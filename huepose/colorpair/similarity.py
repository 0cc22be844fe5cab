"""Similarity of two colour pairs, independent of the light (paper, section III-A).

A pair is a triangle in CIELAB whose third corner is the origin of light. Where the exposure changes by a gain
in linear light, XYZ scales, and so do the cube roots of which CIELAB is made: L + 16, a and b grow by one
common factor. With the origin at L = -16 the triangle is therefore scaled and keeps its shape exactly (for
all but the darkest colours, where CIELAB is linear). Three factors compare the shapes of two triangles:

- directional alignment of the sides from the origin, lightness down-weighted;
- internal contrast: the direction of the third side, lightness down-weighted, relative to the triangle's
  size, with a floor under which a contrast is too small to have a direction;
- relative luminance: the ratio of the two lightnesses.

The comparison is made with the second pair as it is and swapped; the larger value counts.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32
from huepose.support.jit import jit

L_ORIGIN = 16.0
"""CIELAB's offset: L + 16 = 116 cbrt(Y), so that gains scale (L + 16, a, b)."""


LIGHTNESS = 0.4
"""Weight of L in both directions. This and the next four were chosen for the largest area under the ROC curve
between same and different places of rendered views."""

DIRECTION, CONTRAST = 12.0, 1.0
"""How fast those factors fall with 1 - cosine."""

CONTRAST_FLOOR = 0.08
"""Contrast relative to the triangle's size under which its direction fades."""

LUMINANCE_SIGMA = 0.2
"""Standard deviation of the logarithm of the lightness ratio."""

LUMINANCE = 0.5 / LUMINANCE_SIGMA**2
"""How fast that factor falls with the square of the logarithm."""


def paired_similarity(a: Float32, b: Float32) -> Float32:
    """Similarities (N,) float32 in 0..1 of colour pairs `a` (N, 2, 3) with `b` (N, 2, 3), CIELAB, row by row.

    1 for equal pairs; symmetric; the same when the two colours of a pair change places.
    """
    return _paired(shapes(a), shapes(b))


def shapes(pairs: Float32) -> Float32:
    """The features that are compared, (N, 11) float32: unit directions of both sides, the contrast with its
    floor as a unit vector in four dimensions, the logarithm of the lightness ratio. Swapping negates [6:9]
    and [10]."""
    p = np.asarray(pairs, np.float32).reshape(-1, 2, 3) + np.array([L_ORIGIN, 0, 0], np.float32)
    p[..., 0] = np.maximum(p[..., 0], 1.0)
    ratio = np.log(p[:, 1, 0] / p[:, 0, 0])
    p[..., 0] *= LIGHTNESS
    length = np.linalg.norm(p, axis=2)
    contrast = (p[:, 1] - p[:, 0]) / length.mean(1)[:, None]
    floor = np.full((len(p), 1), CONTRAST_FLOOR, np.float32)
    contrast = np.concatenate([contrast, floor], 1)
    contrast /= np.linalg.norm(contrast, axis=1, keepdims=True)
    sides = (p / length[..., None]).reshape(-1, 6)
    return np.concatenate([sides, contrast, ratio[:, None]], 1).astype(np.float32)


@jit
def _score(x: Float32, y: Float32) -> float:
    """Similarity of two shapes (11,)."""
    d00 = x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
    d11 = x[3] * y[3] + x[4] * y[4] + x[5] * y[5]
    d01 = x[0] * y[3] + x[1] * y[4] + x[2] * y[5]
    d10 = x[3] * y[0] + x[4] * y[1] + x[5] * y[2]
    third_side = x[6] * y[6] + x[7] * y[7] + x[8] * y[8]
    floor = x[9] * y[9]
    same = x[10] - y[10]
    swapped = x[10] + y[10]
    straight = DIRECTION * (2 - d00 - d11) + CONTRAST * (1 - third_side - floor) + LUMINANCE * same * same
    crossed = (
        DIRECTION * (2 - d01 - d10) + CONTRAST * (1 + third_side - floor) + LUMINANCE * swapped * swapped
    )
    return float(np.exp(-max(min(straight, crossed), 0.0)))


@jit
def _paired(x: Float32, y: Float32) -> Float32:
    out = np.empty(x.shape[0], np.float32)
    for i in range(x.shape[0]):
        out[i] = _score(x[i], y[i])
    return out
