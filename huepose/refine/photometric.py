"""Factor: the colours of the model's samples onto the image's (Lucas and Kanade 1981, on surface samples).

Depth says nothing of a turn about an axis of symmetry or a slide along a flat face; texture does. Light,
trust in a sample and the scale of the image are the caller's: residuals, weights and gradients hold them.
"""

from __future__ import annotations

from typing import NamedTuple

from huepose.geometry.arrays import Float64
from huepose.refine.solver import Body, NormalEquations, add_residual, image_row
from huepose.support.jit import jit_dividing


class ColorSamples(NamedTuple):
    """Samples at the pixels that they fall on: points (N, 3) object axes; residuals (N, C), lit texture less
    image; gradients (N, C, 2) of the image, per pixel, right and down; weights (N,); information (C,), one
    over the variance of each channel."""

    points: Float64
    residuals: Float64
    gradients: Float64
    weights: Float64
    information: Float64


@jit_dividing
def add_colors(
    T: Float64, samples: ColorSamples, camera: Float64, body: Body, equations: NormalEquations
) -> None:
    """Add the residuals of all samples that have weight. camera (4,): fx, fy, cx, cy of the image."""
    p, gradients = samples.points, samples.gradients
    for k in range(p.shape[0]):
        if samples.weights[k] <= 0.0:
            continue
        for c in range(samples.residuals.shape[1]):
            gu, gv = gradients[k, c, 0], gradients[k, c, 1]
            row = image_row(T, p[k, 0], p[k, 1], p[k, 2], gu, gv, camera, body)
            w = samples.weights[k] * samples.information[c]
            add_residual(equations, w, samples.residuals[k, c], row)
