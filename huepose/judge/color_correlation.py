"""Colour agreement of texture and image, independent of the light: a weighted correlation from sums over
samples."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.judge.kernel_arrays import RegionArrays
from huepose.judge.weights import ScoreWeights
from huepose.support.jit import jit_dividing

SHADING_RIDGE = 0.03
"""Ridge regularisation when lightness is fitted to normals, as a variance of a normal's component. It keeps
the slopes small where normals hardly vary."""


PLAIN = 4.0
"""Contrast that counts as none, opponent units. It is added to the sum of the channels' weights. Where the
light is known, the mean colour decides with this share of the weight."""

LIGHT_SIGMA = (14.0, 7.0, 7.0)
"""Standard deviations of the mean colour of a known object in known light, per channel, opponent units:
mostly from shading."""


@jit_dividing
def color_agreement(
    samples: Float64, count: int, weight: float, weights: ScoreWeights, region: RegionArrays, seen: Float64
) -> float:
    """Correlation of texture and image over channels and scales, each weighted by how much texture there is.

    samples (20 or more, N): the first `count` columns are used. Rows 4..6: normal; 7: weight (their sum is
    `weight`); 8..13: colours of the texture at both scales; 14..19: of the image.

    Shading by distant lights is linear in the normal. So the part of lightness that the normals explain is
    removed from both sides before they are compared. PLAIN in the sum of weights lowers the agreement of
    objects without texture; where the light is known, their mean colour makes up for it. Writes to seen (4,)
    the contrast of the visible texture, and the mean colour of the image minus that of the texture: the
    effect of the light.
    """
    n0, n1, n2, a00, a11, a22, a01, a02, a12 = _spread_of_normals(samples, count, weight)
    # Cholesky factor of the regularised covariance, once for all four right-hand sides.
    l00 = np.sqrt(a00 + SHADING_RIDGE)
    l10, l20 = a01 / l00, a02 / l00
    l11 = np.sqrt(a11 + SHADING_RIDGE - l10 * l10)
    l21 = (a12 - l20 * l10) / l11
    l22 = np.sqrt(a22 + SHADING_RIDGE - l20 * l20 - l21 * l21)
    total, total_weight, off = 0.0, PLAIN, 0.0
    for q in range(6):
        s_m, s_i, s_mm, s_ii, s_mi = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            g, m, i = samples[7, k], samples[8 + q, k], samples[14 + q, k]
            gm, gi = g * m, g * i
            s_m += gm
            s_i += gi
            s_mm += gm * m
            s_ii += gi * i
            s_mi += gm * i
        mean_m, mean_i = s_m / weight, s_i / weight
        var_m = s_mm / weight - mean_m * mean_m
        var_i = s_ii / weight - mean_i * mean_i
        covariance = s_mi / weight - mean_m * mean_i
        if q < 3:
            seen[1 + q] = mean_i - mean_m
            off += ((mean_i - mean_m - region.light[q]) / LIGHT_SIGMA[q]) ** 2
        w = 1.0 if q < 3 else weights.coarse
        if q % 3 == 0:
            w *= weights.lightness
            m0, m1, m2, i0, i1, i2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(count):
                gm, gi = samples[7, k] * samples[8 + q, k], samples[7, k] * samples[14 + q, k]
                m0 += gm * samples[4, k]
                m1 += gm * samples[5, k]
                m2 += gm * samples[6, k]
                i0 += gi * samples[4, k]
                i1 += gi * samples[5, k]
                i2 += gi * samples[6, k]
            m0, m1, m2 = m0 / weight - n0 * mean_m, m1 / weight - n1 * mean_m, m2 / weight - n2 * mean_m
            i0, i1, i2 = i0 / weight - n0 * mean_i, i1 / weight - n1 * mean_i, i2 / weight - n2 * mean_i
            # Slopes of lightness over the normal, of texture and image.
            f0 = m0 / l00
            f1 = (m1 - l10 * f0) / l11
            x2 = (m2 - l20 * f0 - l21 * f1) / l22 / l22
            x1 = (f1 - l21 * x2) / l11
            x0 = (f0 - l10 * x1 - l20 * x2) / l00
            f0 = i0 / l00
            f1 = (i1 - l10 * f0) / l11
            y2 = (i2 - l20 * f0 - l21 * f1) / l22 / l22
            y1 = (f1 - l21 * y2) / l11
            y0 = (f0 - l10 * y1 - l20 * y2) / l00
            ax0, ax1, ax2 = (
                a00 * x0 + a01 * x1 + a02 * x2,
                a01 * x0 + a11 * x1 + a12 * x2,
                a02 * x0 + a12 * x1 + a22 * x2,
            )
            ay0, ay1, ay2 = (
                a00 * y0 + a01 * y1 + a02 * y2,
                a01 * y0 + a11 * y1 + a12 * y2,
                a02 * y0 + a12 * y1 + a22 * y2,
            )
            var_m += x0 * (ax0 - 2.0 * m0) + x1 * (ax1 - 2.0 * m1) + x2 * (ax2 - 2.0 * m2)
            var_i += y0 * (ay0 - 2.0 * i0) + y1 * (ay1 - 2.0 * i1) + y2 * (ay2 - 2.0 * i2)
            covariance += x0 * (ay0 - i0) + x1 * (ay1 - i1) + x2 * (ay2 - i2)
            covariance -= y0 * m0 + y1 * m1 + y2 * m2
        var_m, var_i = max(var_m, 0.0), max(var_i, 0.0)
        w *= np.sqrt(var_m)
        total += w * covariance / (np.sqrt(var_m * var_i) + weights.color_floor)
        total_weight += w
    seen[0] = total_weight - PLAIN
    if region.lit:
        total += PLAIN * np.exp(-0.5 * off)
    return float(total / total_weight)


@jit_dividing
def _spread_of_normals(
    samples: Float64, count: int, weight: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Weighted mean of the normals, and their covariance: 00, 11, 22, 01, 02, 12."""
    n0, n1, n2, a00, a11, a22, a01, a02, a12 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        g, x, y, z = samples[7, k], samples[4, k], samples[5, k], samples[6, k]
        gx, gy, gz = g * x, g * y, g * z
        n0 += gx
        n1 += gy
        n2 += gz
        a00 += gx * x
        a11 += gy * y
        a22 += gz * z
        a01 += gx * y
        a02 += gx * z
        a12 += gy * z
    n0, n1, n2 = n0 / weight, n1 / weight, n2 / weight
    return (
        n0,
        n1,
        n2,
        a00 / weight - n0 * n0,
        a11 / weight - n1 * n1,
        a22 / weight - n2 * n2,
        a01 / weight - n0 * n1,
        a02 / weight - n0 * n2,
        a12 / weight - n1 * n2,
    )
