"""Do the print and the picture agree in colour, whatever the light? A correlation from running sums."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.kernels import solve_symmetric
from huepose.support.jit import jit

SHADING_RIDGE = 0.03
"""Keeps the fit of lightness to normals small where normals hardly vary (variance of a normal's
component)."""


@jit
def color_agreement(moments: Float64, shading: Float64, weight: float, weights: Float64) -> float:
    """Correlation of texture and image over channels and scales, each weighted by how much print there is.

    Lightness is compared after what the surface's normals explain of it is taken off both sides (shading by
    distant lights is linear in the normal). The 4 added to the sum of weights lowers the colour of objects
    that have no print.
    """
    lightness, coarse, floor = weights[6], weights[7], weights[9]
    A = np.empty((3, 3))
    factor = np.empty((3, 3))
    mean = np.empty(3)
    for r in range(3):
        mean[r] = shading[0, r] / weight
    for r in range(3):
        for c in range(r + 1):
            both = shading[1, r] if r == c else shading[2, r + c - 1]
            A[r, c] = both / weight - mean[r] * mean[c]
            A[c, r] = A[r, c]
    b_m, b_i, x_m, x_i = np.empty(3), np.empty(3), np.zeros(3), np.zeros(3)
    total, total_weight = 0.0, 4.0
    for q in range(6):
        mean_m, mean_i = moments[q, 0] / weight, moments[q, 1] / weight
        var_m = moments[q, 2] / weight - mean_m * mean_m
        var_i = moments[q, 3] / weight - mean_i * mean_i
        covariance = moments[q, 4] / weight - mean_m * mean_i
        w = 1.0 if q < 3 else coarse
        if q % 3 == 0:
            w *= lightness
            row = 3 + 2 * (q // 3)
            for r in range(3):
                b_m[r] = shading[row, r] / weight - mean[r] * mean_m
                b_i[r] = shading[row + 1, r] / weight - mean[r] * mean_i
            for x, b in ((x_m, b_m), (x_i, b_i)):
                for r in range(3):
                    for c in range(3):
                        factor[r, c] = A[r, c] + (SHADING_RIDGE if r == c else 0.0)
                solve_symmetric(factor, b, x)
            for r in range(3):
                var_m -= 2.0 * x_m[r] * b_m[r]
                var_i -= 2.0 * x_i[r] * b_i[r]
                covariance -= x_m[r] * b_i[r] + x_i[r] * b_m[r]
                for c in range(3):
                    var_m += x_m[r] * A[r, c] * x_m[c]
                    var_i += x_i[r] * A[r, c] * x_i[c]
                    covariance += x_m[r] * A[r, c] * x_i[c]
        var_m, var_i = max(var_m, 0.0), max(var_i, 0.0)
        w *= np.sqrt(var_m)
        total += w * covariance / (np.sqrt(var_m * var_i) + floor)
        total_weight += w
    return float(total / total_weight)
