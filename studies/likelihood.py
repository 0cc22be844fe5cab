"""Maximum-likelihood fits for quality: a logistic function, and a choice among scored answers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from huepose.believe.logistic import Logistic, probabilities
from huepose.believe.quality import behind
from huepose.geometry.arrays import Bool, Float64, Int64

RIDGE = 2.0
"""Weight of the ridge penalty on the factors, for features divided by their standard deviations."""

MOST_SHARPNESS, MOST_HANDICAP = 300.0, 3.0
"""Upper bounds of sharpness and handicap."""


def logistic(
    x: Float64, right: Bool, weights: Float64, names: Sequence[str], known: Float64 | float = 0.0
) -> Logistic:
    """A logistic function of features (N, K) by name, without negative factors; right, weights (N,); known
    (N,): a known part of the logit."""
    centre, spread, z = _standard(x)
    sign = np.where(right, 1.0, -1.0)

    def loss(p: Float64) -> tuple[float, Float64]:
        s = sign * (p[0] + z @ p[1:] + known)
        pull = -weights * sign * probabilities(-s)
        slope = np.concatenate([[pull.sum()], pull @ z + RIDGE * p[1:]])
        return float((weights * np.logaddexp(0.0, -s)).sum() + 0.5 * RIDGE * (p[1:] ** 2).sum()), slope

    bounds = [(None, None), *[(0.0, None)] * x.shape[1]]
    found = minimize(loss, np.zeros(1 + x.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    return _named(found[0], found[1:] / spread, centre, names)


def choice(
    x: Float64,
    gaps: Float64,
    sharpeners: Float64,
    which: Int64,
    weights: Float64,
    names: Sequence[str],
    times: Float64,
) -> tuple[Logistic, Float64, float]:
    """Three fits: the probability that one of the answers is right, the sharpness with which the answers
    share it, and the handicap of those behind the first.

    x (N, K): features by name; gaps (N, A): by how much each answer scores less than the first, which is in
    column 0 with 0; inf for no answer; sharpeners (N, S): sharpness is linear in them; which (N,): the right
    answer's column, -1 if none is right; times (N,): factor on the probability, which the fit compensates as
    far as it can. Nothing but the constant may be negative."""
    centre, spread, z = _standard(x)
    count, sharp = x.shape[1], sharpeners.shape[1]
    there = np.isfinite(gaps)
    known = np.where(there, gaps, 0.0)
    less = behind(known)
    none, row, column = which < 0, np.arange(len(which)), np.maximum(which, 0)

    def loss(p: Float64) -> tuple[float, Float64]:
        factors, handicap = p[1 : 1 + count], p[-1]
        one = probabilities(p[0] + z @ factors)
        listed = times * one
        steep = sharpeners @ p[1 + count : 1 + count + sharp]
        weight = np.where(there, np.exp(-steep[:, None] * known - handicap * less), 0.0)
        share = weight / weight.sum(1, keepdims=True)
        likely = np.maximum(np.where(none, 1.0 - listed, listed * share[row, column]), 1e-9)
        misfit = -(weights * np.log(likely)).sum()
        pull = weights * np.where(none, listed / np.maximum(1.0 - listed, 1e-9), -1.0) * (1.0 - one)
        counted = np.where(none, 0.0, weights)
        sharper = counted * (known[row, column] - (share * known).sum(1))
        later = counted * (less[row, column] - (share * less).sum(1))
        slope = [[pull.sum()], pull @ z + RIDGE * factors, sharper @ sharpeners, [later.sum()]]
        return float(misfit + 0.5 * RIDGE * (factors**2).sum()), np.concatenate(slope)

    start = np.concatenate([[1.0], np.full(count, 0.3), np.full(sharp, 10.0), [0.5]])
    bounds = [(None, None), *[(0.0, None)] * count, *[(0.0, MOST_SHARPNESS)] * sharp, (0.0, MOST_HANDICAP)]
    found = minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B").x
    listed = _named(found[0], found[1 : 1 + count] / spread, centre, names)
    return listed, np.asarray(found[1 + count : -1]), float(found[-1])


def _standard(x: Float64) -> tuple[Float64, Float64, Float64]:
    """Means, standard deviations, and the standardised features."""
    centre, spread = x.mean(0), np.maximum(x.std(0), 1e-6)
    return centre, spread, (x - centre) / spread


def _named(constant: float, factors: Float64, centre: Float64, names: Sequence[str]) -> Logistic:
    """The logistic function of the features themselves, from a fit on centred ones."""
    return Logistic(float(constant - factors @ centre), dict(zip(names, factors.tolist(), strict=True)))
