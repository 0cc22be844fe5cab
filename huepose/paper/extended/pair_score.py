"""Judge a pose by colour pairs: does the image have the two colours of the model's pairs where the pose
projects them?

Light is fitted at each pose, as the offset and gain per channel that fit all colours best; so the first term
is a correlation of colours. The second term is a correlation of the differences between the two sides, in
which light and slow shading cancel. The dense score (`judge.terms`), with its colour term switched off,
judges depth, free space and coverage of the mask.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.judge.kernel import SCRATCH_ROWS, TERMS, score_kernel
from huepose.judge.kernel_arrays import ModelArrays, RegionArrays, model_arrays, region_arrays
from huepose.judge.pairs import (
    PAIR_WEIGHTS,
    PairArrays,
    PairImage,
    PairWeights,
    pair_arrays,
    read_pairs,
    room_for,
)
from huepose.judge.region import Region
from huepose.judge.weights import DEFAULT_WEIGHTS, ScoreWeights
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit

PAIR_TERMS = 5
"""Number of terms of a pose: total, geometry, color, contrast, and number of visible pairs."""

GEOMETRY = DEFAULT_WEIGHTS._replace(color=0.0, box=0.2)
"""Weights of the dense score without colour, chosen for this method."""

CLOSE_PAIR_SAMPLES = 600
"""Largest number of surface samples that judge each of the last few poses."""


class Judged(NamedTuple):
    """All inputs of the pair kernel. samples: largest number of surface samples used; geometry, weights:
    weights of the dense score's terms and of the pair terms."""

    model: ModelArrays
    region: RegionArrays
    samples: int
    geometry: ScoreWeights
    pairs: PairArrays
    picture: PairImage
    weights: PairWeights


class PairScratch(NamedTuple):
    """Scratch arrays of the pair kernel; out (5,): the terms of the last pose."""

    moments: Float64
    rows: Float64
    terms: Float64
    out: Float64


def scratch(samples: int) -> PairScratch:
    """Allocate the scratch arrays for at most `samples` surface samples."""
    return PairScratch(
        np.empty((6, 5)), np.empty((SCRATCH_ROWS, samples)), np.empty(TERMS), np.empty(PAIR_TERMS)
    )


@jit
def pair_kernel(T: Float64, on: Judged, work: PairScratch, needed: float) -> float:
    """Judge one pose T (4, 4). Returns the total and writes the terms to `work.out`.

    If the total cannot exceed `needed`, the kernel may stop early. It then returns an upper bound of the
    total that is not over `needed`, and `work.out` is undefined.
    """
    moments, out, weights = work.moments, work.out, on.weights
    moments[:] = 0.0
    visible = _read_pairs(T, on.region, on.pairs, on.picture, moments)
    few = visible / (visible + weights.few)
    color = few * _correlation(moments, 0, weights)
    contrast = few * _correlation(moments, 3, weights)
    colors = weights.color * color + weights.contrast * contrast
    # What geometry has to reach; 1e-9 is more than the rounding error.
    enough = needed - colors - 1e-9
    geometry = score_kernel(T, on.model, on.region, on.samples, on.geometry, work.rows, work.terms, enough)
    out[0] = geometry + colors
    out[1] = geometry
    out[2] = color
    out[3] = contrast
    out[4] = visible
    return float(out[0])


@jit
def _read_pairs(
    T: Float64, region: RegionArrays, pairs: PairArrays, picture: PairImage, moments: Float64
) -> int:
    """Add sums over the visible pairs to `moments` (6, 5): rows 0..2 for the channels of both sides (weight,
    model, image and so on as below), rows 3..5 for the differences between the sides. Returns the number of
    visible pairs."""
    colors, found = pairs.colors, room_for(pairs)
    visible = read_pairs(T, region, pairs, picture, found)
    for k in range(visible):
        i, facing, read = found.which[k], found.facing[k], found.colors[k]
        for c in range(3):
            for side in range(2):
                m, s = colors[i, side, c], read[side, c]
                moments[c, 0] += facing * m
                moments[c, 1] += facing * s
                moments[c, 2] += facing * m * m
                moments[c, 3] += facing * s * s
                moments[c, 4] += facing * m * s
            m, s = colors[i, 1, c] - colors[i, 0, c], read[1, c] - read[0, c]
            moments[3 + c, 0] += facing  # the sum of weights; no mean is subtracted from differences
            moments[3 + c, 2] += facing * m * m
            moments[3 + c, 3] += facing * s * s
            moments[3 + c, 4] += facing * m * s
    return visible


@jit
def _correlation(moments: Float64, first: int, weights: PairWeights) -> float:
    """Mean correlation of the three channels from row `first` on, each weighted by the model's standard
    deviation in it."""
    count = moments[3, 0]
    if count <= 0.0:
        return 0.0
    readings = 2.0 * count if first == 0 else count
    total, total_weight = 0.0, weights.even
    for c in range(3):
        q = first + c
        mean_m, mean_s = 0.0, 0.0
        if first == 0:
            mean_m, mean_s = moments[q, 0] / readings, moments[q, 1] / readings
        var_m = max(moments[q, 2] / readings - mean_m * mean_m, 0.0)
        var_s = max(moments[q, 3] / readings - mean_s * mean_s, 0.0)
        covariance = moments[q, 4] / readings - mean_m * mean_s
        w = (weights.lightness if c == 0 else 1.0) * np.sqrt(var_m)
        total += w * covariance / (np.sqrt(var_m * var_s) + weights.floor)
        total_weight += w
    return float(total / total_weight)


def pair_score_many(
    model: ReferenceModel,
    region: Region,
    picture: PairImage,
    poses: Float,
    pairs: int,
    samples: int,
) -> Float64:
    """Judge poses (M, 4, 4) by at most `pairs` of the model's pairs and `samples` of its surface.

    Returns (M, 5): total, comparable between poses on the same pixels; geometry, the dense score without
    colour; color and contrast, correlations in -1..1, lowered if few pairs are visible; number of visible
    pairs.
    """
    out = np.zeros((len(poses), PAIR_TERMS))
    on = judged_on(model, region, picture, pairs, samples)
    _score_all(np.ascontiguousarray(poses, dtype=np.float64), on, scratch(samples), out)
    return out


def judged_on(
    model: ReferenceModel,
    region: Region,
    picture: PairImage,
    pairs: int,
    samples: int,
) -> Judged:
    """Bundle at most `pairs` of the model's pairs, its surface and the image for the kernel."""
    return Judged(
        model_arrays(model),
        region_arrays(region),
        samples,
        GEOMETRY,
        pair_arrays(model.pairs, pairs),
        picture,
        PAIR_WEIGHTS,
    )


@jit
def _score_all(poses: Float64, on: Judged, work: PairScratch, out: Float64) -> None:
    for i in range(poses.shape[0]):
        pair_kernel(poses[i], on, work, -np.inf)
        out[i] = work.out
