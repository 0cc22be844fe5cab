"""What the light does to a texture, fitted robustly to the samples in view (compiled).

Image colour = gain * texture + offset per opponent channel, and for lightness also a slope over the direction
that the surface faces, which is what a distant lamp does to a matt surface. So neither the colour of the
light nor its side moves a pose.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.kernels import solve_symmetric
from huepose.refine.robust import cauchy
from huepose.refine.samples import Samples
from huepose.support.jit import jit_dividing

GAIN_PRIOR = 4.0
"""Weight of the expectation that contrast is kept, as a variance in opponent units."""

SLOPE_PRIOR = 0.02

GAIN_LIMITS = (0.3, 2.5)

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
    correlation (3,) of texture and image when offset and slope are taken out; rms (3,): robust, opponent
    units."""
    A = np.empty((5, 5))
    b = np.empty(5)
    f = np.empty(5)
    x = np.empty(5)
    gain = np.ones(3)
    for k in range(n):
        trust[k] = 1.0 if weight[k] > 0.0 else 0.0
    for _ in range(rounds):
        for c in range(3):
            m = 5 if c == 0 else 2
            A[:] = 0.0
            b[:] = 0.0
            total = 1e-9
            for k in range(n):
                w = weight[k] * trust[k]
                if w <= 0.0:
                    continue
                f[0], f[1] = reference[samples.which[k], c], 1.0
                # Visible normals point at the camera: -0.7 in z on average.
                f[2], f[3], f[4] = samples.normals[k, 0], samples.normals[k, 1], samples.normals[k, 2] + 0.7
                for i in range(m):
                    b[i] += w * f[i] * color[k, c]
                    for j in range(i + 1):
                        A[i, j] += w * f[i] * f[j]
                total += w
            A[0, 0] += GAIN_PRIOR * total
            b[0] += GAIN_PRIOR * total
            A[1, 1] += 1e-4 * total
            for i in range(2, m):
                A[i, i] += SLOPE_PRIOR * total
            x[:] = 0.0
            solve_symmetric(A[:m, :m], b[:m], x[:m])
            gain[c] = min(max(x[0], GAIN_LIMITS[0]), GAIN_LIMITS[1])
            square = 0.0
            for k in range(n):
                if weight[k] <= 0.0:
                    continue
                lit = x[2] * samples.normals[k, 0] + x[3] * samples.normals[k, 1]
                lit += x[4] * (samples.normals[k, 2] + 0.7)
                residual[k, c] = color[k, c] - gain[c] * reference[samples.which[k], c] - x[1] - lit
                square += weight[k] * trust[k] * residual[k, c] ** 2
            rms[c] = np.sqrt(square / total)
        for k in range(n):
            if weight[k] <= 0.0:
                trust[k] = 0.0
                continue
            d = 0.0
            for c in range(3):
                d += (residual[k, c] / max(rms[c], TRUST_FLOOR)) ** 2
            trust[k] = cauchy(d / 3.0)
    for c in range(3):
        total = 1e-9
        sx = sy = sxx = syy = sxy = 0.0
        for k in range(n):
            w = weight[k]
            if w <= 0.0:
                continue
            texture = reference[samples.which[k], c]
            image = residual[k, c] + gain[c] * texture
            total += w
            sx += w * texture
            sy += w * image
            sxx += w * texture * texture
            syy += w * image * image
            sxy += w * texture * image
        sx /= total
        sy /= total
        vx, vy = max(sxx / total - sx * sx, 0.0), max(syy / total - sy * sy, 0.0)
        correlation[c] = (sxy / total - sx * sy) / (np.sqrt(vx * vy) + CORRELATION_FLOOR)
