"""From scene pairs to classified points: robust matching, then decoupling into two colours (paper, section
III-C).

Every scene pair votes, by its similarity to the model's pairs, for a pair of classes, one for each side. The
confidence is the larger, the more votes the winner has than the second. A confident match becomes two points,
one for each side, with the class of the side; the confidence is their weight.
"""

from __future__ import annotations

import numpy as np

from huepose.colorpair.similarity import CONTRAST, DIRECTION, LUMINANCE, shapes
from huepose.colorpair.types import SurfacePairs
from huepose.geometry.arrays import Float32, UInt8
from huepose.paper.cloud import ClassifiedCloud, decoupled
from huepose.support.jit import jit

MODEL_PAIRS = 600
"""Largest number of the model's pairs that are compared."""

SHARPNESS = 3.0
"""Exponent on the similarity of a vote."""

LEAST_CONFIDENCE = 0.1
"""A pair with less confidence is not used."""


def classified(
    scene: SurfacePairs, model: SurfacePairs, side_classes: UInt8, classes: int, offset_m: float
) -> ClassifiedCloud:
    """The classified cloud of a scene whose colours (N, 2, 3) are those under the model's light.

    side_classes (M, 2) of the model's pairs, 0..classes-1; the side points lie `offset_m` from the edge.
    """
    chosen, confidence = classify(scene.colors, model.colors, side_classes, classes)
    sure = confidence >= LEAST_CONFIDENCE
    weights = np.repeat(confidence[sure][:, None], 2, 1)
    return decoupled(
        scene.points[sure], scene.normals[sure], scene.tangents[sure], chosen[sure], weights, offset_m
    )


def classify(scene: Float32, model: Float32, side_classes: UInt8, classes: int) -> tuple[UInt8, Float32]:
    """Classes (N, 2) of the sides of scene pairs (N, 2, 3), and confidences (N,) in 0..1: the similarity of
    the nearest model pair times the lead of the winning classes over the second."""
    if not len(scene) or not len(model):
        return np.zeros((len(scene), 2), np.uint8), np.zeros(len(scene), np.float32)
    step = -(-len(model) // MODEL_PAIRS)
    sides = np.ascontiguousarray(side_classes[::step])
    return _classify(shapes(scene), shapes(model[::step]), sides, classes)


@jit
def exchange(x: Float32, out: Float32) -> None:
    """Write into `out` the shape (11,) of a pair whose sides are exchanged."""
    for q in range(6):
        out[q] = x[(q + 3) % 6]
    for q in range(6, 9):
        out[q] = -x[q]
    out[9] = x[9]
    out[10] = -x[10]


@jit
def _classify(x: Float32, y: Float32, side_classes: UInt8, classes: int) -> tuple[UInt8, Float32]:
    chosen = np.zeros((x.shape[0], 2), np.uint8)
    confidence = np.zeros(x.shape[0], np.float32)
    votes = np.empty(classes * classes)
    exchanged = np.empty(x.shape[1], np.float32)
    for i in range(x.shape[0]):
        exchange(x[i], exchanged)
        votes[:] = 0.0
        nearest = 1e9
        for j in range(y.shape[0]):
            straight = pair_cost(x[i], y[j])
            crossed = pair_cost(exchanged, y[j])
            a, b = int(side_classes[j, 0]), int(side_classes[j, 1])
            votes[a * classes + b] += np.exp(-SHARPNESS * straight)
            votes[b * classes + a] += np.exp(-SHARPNESS * crossed)
            nearest = min(nearest, straight, crossed)
        best, second, at = 0.0, 0.0, 0
        for k in range(votes.shape[0]):
            if votes[k] > best:
                second = best
                best = votes[k]
                at = k
            elif votes[k] > second:
                second = votes[k]
        if best > 0.0:
            chosen[i, 0] = at // classes
            chosen[i, 1] = at % classes
            confidence[i] = np.exp(-nearest) * (1.0 - second / best)
    return chosen, confidence


@jit
def pair_cost(x: Float32, y: Float32) -> float:
    """Minus the logarithm of the similarity of two shapes, without exchanging sides."""
    d = 2 - (x[0] * y[0] + x[1] * y[1] + x[2] * y[2]) - (x[3] * y[3] + x[4] * y[4] + x[5] * y[5])
    c = 1 - (x[6] * y[6] + x[7] * y[7] + x[8] * y[8]) - x[9] * y[9]
    r = x[10] - y[10]
    return float(DIRECTION * d + CONTRAST * c + LUMINANCE * r * r)
