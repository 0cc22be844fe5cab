"""How much of the texture agrees with the picture, when some of it may be out of date or hidden?

A correlation (see `pairs`) is pulled most by what disagrees most: a third of a surface in other, stronger
colours outweighs the rest, and the wrong way round may correlate better than the right one. So here every
pair speaks for itself and at most so loudly: one that disagrees wholly counts as nothing, and not as less
than nothing. Two shares, each 0..1: of the contrasts between the two sides, where light cancels, and of the
colours under the light that most of them agree on.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.judge.arrays import RegionArrays, region_arrays
from huepose.judge.pair_kernel import PairArrays, PairPicture, read_pair
from huepose.judge.pair_terms import DEFAULT_PAIR_WEIGHTS, pair_arrays
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit

LIGHTNESS, FLOOR, FEW = DEFAULT_PAIR_WEIGHTS.lightness, DEFAULT_PAIR_WEIGHTS.floor, DEFAULT_PAIR_WEIGHTS.few
"""As the score of pairs has them."""

HALF = 16.0
"""Units of opponents off the common light at which a colour counts half."""

ROUNDS = 3
FEWEST = 5
"""Under so many visible pairs nothing is said."""


def agreement_many(
    model: ReferenceModel, region: Region, picture: PairPicture, poses: Float, pairs: int = 1500
) -> Float64:
    """Both shares added up, 0..2, at poses (M, 4, 4), by at most `pairs` of the model's pairs: (M,)."""
    out = np.zeros(len(poses))
    _agree_all(
        np.ascontiguousarray(poses, dtype=np.float64),
        region_arrays(region),
        pair_arrays(model.pairs, pairs),
        picture,
        out,
    )
    return out


@jit
def _agree_all(
    poses: Float64, region: RegionArrays, pairs: PairArrays, picture: PairPicture, out: Float64
) -> None:
    count = pairs.points.shape[0]
    weights, model, seen = np.empty(count), np.empty((count, 2, 3)), np.empty((count, 2, 3))
    for m in range(poses.shape[0]):
        n = 0
        for i in range(count):
            facing = read_pair(poses[m], i, region, pairs, picture, seen[n])
            if facing > 0.0:
                weights[n] = facing
                model[n] = pairs.colors[i]
                n += 1
        if n >= FEWEST:
            shares = _contrasts(weights[:n], model[:n], seen[:n]) + _colors(weights[:n], model[:n], seen[:n])
            out[m] = n / (n + FEW) * shares


@jit
def _contrasts(weights: Float64, model: Float64, seen: Float64) -> float:
    """Share of the texture's contrasts that the picture shows, each between nothing and all of its own; none
    speaks louder than the usual one."""
    n = weights.shape[0]
    along, ours, theirs = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        dot, mm, ss = 0.0, 0.0, 0.0
        for c in range(3):
            w = LIGHTNESS if c == 0 else 1.0
            a, b = w * (model[i, 1, c] - model[i, 0, c]), w * (seen[i, 1, c] - seen[i, 0, c])
            dot += a * b
            mm += a * a
            ss += b * b
        along[i], ours[i], theirs[i] = dot, np.sqrt(mm) + 1e-9, np.sqrt(ss) + 1e-9
    typical = np.median(ours)
    gain = min(max(np.median(theirs) / typical, 0.3), 3.0)
    total, agreed = 0.0, 0.0
    for i in range(n):
        longer, voice = max(ours[i], theirs[i] / gain), weights[i] * min(ours[i], typical)
        total += voice
        agreed += voice * max(along[i] / gain / (longer * longer), 0.0)
    return float(agreed / total)


@jit
def _colors(weights: Float64, model: Float64, seen: Float64) -> float:
    """Share of the sides that have their colour under the offset and gain per channel on which most agree:
    from the median offset on, reweighted least squares with the weights of Cauchy, squared."""
    n = weights.shape[0]
    off, trust, total = np.zeros((n, 2)), np.empty((n, 2)), 2.0 * weights.sum()
    for c in range(3):
        apart = seen[:, :, c] - model[:, :, c]
        w = (LIGHTNESS if c == 0 else 1.0) / (HALF * HALF)
        off += w * (apart - np.median(apart)) ** 2
    for _ in range(ROUNDS):
        for i in range(n):
            for side in range(2):
                trust[i, side] = weights[i] / (1.0 + off[i, side]) ** 2
        off[:] = 0.0
        for c in range(3):
            t, sm, ss, mm, ms = 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(n):
                for side in range(2):
                    k, m, s = trust[i, side], model[i, side, c], seen[i, side, c]
                    t += k
                    sm += k * m
                    ss += k * s
                    mm += k * m * m
                    ms += k * m * s
            mean_m, mean_s = sm / t, ss / t
            spread = mm / t - mean_m * mean_m
            gain = (ms / t - mean_m * mean_s) / (spread + FLOOR * FLOOR)
            gain = min(max(gain, 0.2), 3.0)
            w = (LIGHTNESS if c == 0 else 1.0) / (HALF * HALF)
            for i in range(n):
                for side in range(2):
                    e = (seen[i, side, c] - mean_s) / gain - (model[i, side, c] - mean_m)
                    off[i, side] += w * e * e
    agreed = 0.0
    for i in range(n):
        agreed += weights[i] / (1.0 + off[i, 0]) + weights[i] / (1.0 + off[i, 1])
    return float(agreed / total)
