"""Fit the light robustly to the visible samples (compiled).

Image colour = gain * texture + offset per opponent channel; lightness also has a slope over the surface
normal, the effect of a distant lamp on a matt surface. So neither the colour nor the direction of the light
moves a pose.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.refine.samples import Samples
from huepose.refine.solver import cauchy, solve_symmetric
from huepose.support.jit import jit_dividing

GAIN_PRIOR = 4.0
"""Weight of the expectation that contrast is kept, as a variance in opponent units."""

SLOPE_PRIOR = 0.02
"""Weight of the expectation that lightness does not change with the slope of the surface, as a share of all
weights."""

GAIN_LIMITS = (0.3, 2.5)
"""Limits of the image's contrast relative to the texture's."""

TRUST_FLOOR = 1.5
"""Opponent units: no residual below this makes a sample doubtful."""

CORRELATION_FLOOR = 6.0
"""Opponent units squared: where neither texture nor image vary more than this, their correlation means
little."""


@jit_dividing
def fit_light(
    n: int,
    samples: Samples,
    weight: Float64,
    reference: Float32,
    color: Float64,
    rounds: int,
    residual: Float64,
    trust: Float64,
    correlation: Float64,
    rms: Float64,
) -> None:
    """Fit the light to `color` (n, 3) of samples whose texture is `reference` (N, 3), with weights (n,).

    Writes residual (n, 3) = image - predicted; trust (n,): Cauchy weights of the samples over all channels;
    correlation (3,) of texture and image without offset and slope; rms (3,): robust, opponent units."""
    # Samples with a weight are packed side by side, so that loops over them can be vectorised.
    index, given, trusted, misfit = np.empty(n, np.int32), np.empty(n), np.ones(n), np.empty(n)
    facing, texture, image, left = np.empty((3, n)), np.empty((3, n)), np.empty((3, n)), np.empty((3, n))
    m = 0
    for k in range(n):
        trust[k] = 0.0
        if weight[k] > 0.0:
            index[m], given[m] = k, weight[k]
            for c in range(3):
                texture[c, m], image[c, m] = reference[samples.which[k], c], color[k, c]
                facing[c, m] = samples.normals[k, c]
            facing[2, m] += 0.7  # visible normals point at the camera: -0.7 in z on average
            m += 1
    A, b, x, gain = np.empty((5, 5)), np.empty(5), np.empty(5), np.ones(3)
    for _ in range(rounds):
        misfit[:m] = 0.0
        for c in range(3):
            unknowns = 5 if c == 0 else 2
            total = _add_gain(m, given, trusted, texture[c], image[c], A, b)
            if c == 0:
                _add_slope(m, given, trusted, texture[c], image[c], facing, A, b)
                for i in range(2, unknowns):
                    A[i, i] += SLOPE_PRIOR * total
            x[:] = 0.0
            solve_symmetric(A[:unknowns, :unknowns], b[:unknowns], x[:unknowns])
            gain[c] = min(max(x[0], GAIN_LIMITS[0]), GAIN_LIMITS[1])
            square = _residuals(m, given, trusted, texture[c], image[c], facing, gain[c], x, left[c])
            rms[c] = np.sqrt(square / total)
            share = 1.0 / (3.0 * max(rms[c], TRUST_FLOOR) ** 2)
            for k in range(m):
                misfit[k] += share * left[c, k] ** 2
        for k in range(m):
            trusted[k] = cauchy(misfit[k])
    for c in range(3):
        correlation[c] = _correlation(m, given, texture[c], left[c], gain[c])
    for k in range(m):
        trust[index[k]] = trusted[k]
        for c in range(3):
            residual[index[k], c] = left[c, k]


@jit_dividing
def _add_gain(
    m: int, weight: Float64, trust: Float64, texture: Float64, image: Float64, A: Float64, b: Float64
) -> float:
    """Begin the normal equations with gain and offset; returns the sum of the weights."""
    total = by_texture = by_square = by_image = by_both = 0.0
    for k in range(m):
        w, t = weight[k] * trust[k], texture[k]
        total += w
        by_texture += w * t
        by_square += w * t * t
        by_image += w * image[k]
        by_both += w * t * image[k]
    total += 1e-9
    A[0, 0], A[1, 0], A[1, 1] = by_square + GAIN_PRIOR * total, by_texture, (1.0 + 1e-4) * total
    b[0], b[1] = by_both + GAIN_PRIOR * total, by_image
    return total


@jit_dividing
def _add_slope(
    m: int,
    weight: Float64,
    trust: Float64,
    texture: Float64,
    image: Float64,
    facing: Float64,
    A: Float64,
    b: Float64,
) -> None:
    """Add the slope over the direction that the surface faces (3, m), rows 2 to 4."""
    for i in range(3):
        by_texture = by_one = by_image = 0.0
        for k in range(m):
            w = weight[k] * trust[k] * facing[i, k]
            by_texture += w * texture[k]
            by_one += w
            by_image += w * image[k]
        A[2 + i, 0], A[2 + i, 1], b[2 + i] = by_texture, by_one, by_image
        for j in range(i + 1):
            both = 0.0
            for k in range(m):
                both += weight[k] * trust[k] * facing[i, k] * facing[j, k]
            A[2 + i, 2 + j] = both


@jit_dividing
def _residuals(
    m: int,
    weight: Float64,
    trust: Float64,
    texture: Float64,
    image: Float64,
    facing: Float64,
    gain: float,
    x: Float64,
    residual: Float64,
) -> float:
    """Fill in image - predicted (m,) of a channel; returns the weighted sum of squares."""
    offset, right, down, ahead = x[1], x[2], x[3], x[4]
    square = 0.0
    for k in range(m):
        lit = offset + right * facing[0, k] + down * facing[1, k] + ahead * facing[2, k]
        residual[k] = image[k] - gain * texture[k] - lit
        square += weight[k] * trust[k] * residual[k] ** 2
    return square


@jit_dividing
def _correlation(m: int, weight: Float64, texture: Float64, residual: Float64, gain: float) -> float:
    """Correlation of texture and image without offset and slope."""
    total, sx, sy, sxx, syy, sxy = 1e-9, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(m):
        w, t = weight[k], texture[k]
        image = residual[k] + gain * t
        total += w
        sx += w * t
        sy += w * image
        sxx += w * t * t
        syy += w * image * image
        sxy += w * t * image
    sx /= total
    sy /= total
    vx, vy = max(sxx / total - sx * sx, 0.0), max(syy / total - sy * sy, 0.0)
    return float((sxy / total - sx * sy) / (np.sqrt(vx * vy) + CORRELATION_FLOOR))
