"""How far a pose may be trusted: a probability that it is right.

Quality is the product of three probabilities: that it is this texture that is seen and not another one on
such a shape, that it is this size, and that the pose is right then. The last one is a choice: the chance that
any of the poses that were found is right is shared out by their scores, so that a near-tie is published as
one, each pose with its probability. Whether an object is there at all is a question of its own, which decides
whether anything is said to be found. The numbers are fitted on drawn scenes (`believe.logistic`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from huepose.believe.logistic import Logistic, fitted
from huepose.geometry.arrays import Float64

# Beyond which a term says nothing more. Part of the fit: another value needs a new one (`studies.quality`).
# Chosen before the fit.

MOST_MARGIN = 0.3
"""Of the totals, to the next other pose; also that of a pose without any other."""

MOST_SIZE, MOST_NEAR_SIZE = 0.15, 0.05
"""Of the scale residual, for whether it is this size, and for whether the object is there at all: so much may
come of what is not the object's among the points."""

TIE = 0.02
"""Gaps of totals much smaller than this are ties, in which chance has put one answer first."""


@dataclass(frozen=True)
class QualityTerms:
    """What quality is a function of. total: score of the pose; gaps: how much less the other answers score,
    best first; color, box_iou, depth_fit, coverage, violation, occluded, seen: terms of its dense score (see
    `judge.terms.Terms`); missing, foreign, detail, turned: see `texture_evidence.TextureEvidence`;
    scale_residual: by how much the depth would have the object larger (see `refine.final`); pixels: of the
    image that are believed to show the object; otherwise: share of the contrasts at the model's pairs that
    point in another colour; agreed: what those that agree say (both `judge.texture_evidence`)."""

    total: float
    gaps: tuple[float, ...]
    color: float
    box_iou: float
    depth_fit: float
    coverage: float
    violation: float
    occluded: float
    seen: float
    missing: float
    foreign: float
    detail: float
    scale_residual: float
    pixels: float
    turned: float
    otherwise: float
    agreed: float

    @property
    def margin(self) -> float:
        """To the best other answer, at most MOST_MARGIN, which it also is where there is no other."""
        return min(max(self.gaps[0], 0.0), MOST_MARGIN) if self.gaps else MOST_MARGIN


@dataclass(frozen=True)
class QualityFit:
    """presence: that the object is there, in whatever texture; this_texture, this_size: that it is not
    another texture or another size of it; listed: that one of the poses is right. They share it by
    exp(-sharpness x gap), where sharpness is a constant and a factor times each feature, all but the best
    lowered further, by exp(-handicap) where they are clearly behind and by nothing where they are not
    (`behind`). level: the quality over which 99 % of the poses of the calibration scenes were right; found:
    the presence under which nothing is there."""

    presence: Logistic
    this_texture: Logistic
    this_size: Logistic
    listed: Logistic
    sharpness: Mapping[str, float]
    handicap: float
    level: float
    found: float

    def probabilities(self, terms: QualityTerms) -> Float64:
        """Of the pose and of each other answer (1 + K,), that it is the right one; at most 1 in sum."""
        known = features(terms)
        known["constant"] = 1.0
        sharpness = sum(factor * max(known[name], 0.0) for name, factor in self.sharpness.items())
        one_of_them = self.this_texture(known) * self.this_size(known) * self.listed(known)
        return np.asarray(one_of_them * shares(terms, sharpness, self.handicap))

    def present(self, terms: QualityTerms) -> float:
        """Probability in 0..1 that the object is here at all."""
        return self.presence(features(terms))


def shares(terms: QualityTerms, sharpness: float, handicap: float) -> Float64:
    """How the pose and the other answers share what there is (1 + K,), 1 in sum.

    >>> from dataclasses import replace
    >>> tied = QualityTerms(2.0, (0.0,), 0.6, 0.9, 0.9, 0.9, 0.0, 0.0, 0.9, 0.1, 9.0, 0.5, 0.0, 4000, 0, 0, 1)
    >>> shares(tied, 40.0, 1.0).tolist()
    [0.5, 0.5]
    >>> shares(replace(tied, gaps=(0.1, 0.3)), 40.0, 0.0).round(3).tolist()
    [0.982, 0.018, 0.0]
    """
    gaps = np.maximum(np.array(terms.gaps), 0.0)
    weight = np.exp(-sharpness * gaps - handicap * behind(gaps))
    every = np.concatenate([[1.0], weight])
    return np.asarray(every / every.sum())


def behind(gaps: Float64) -> Float64:
    """How far answers with these gaps, of any shape, are behind at all: 0 for a tie, 1 for a clear second."""
    return np.asarray(np.tanh(gaps / TIE))


def features(terms: QualityTerms) -> dict[str, float]:
    """The terms in the form in which they enter a logit: the larger, the surer, for every one of them."""
    return {
        "margin": terms.margin,
        "total": terms.total,
        "color": terms.color,
        "box_iou": terms.box_iou,
        "depth_fit": terms.depth_fit,
        "coverage": terms.coverage,
        "no_violation": 1.0 - terms.violation,
        "not_occluded": 1.0 - terms.occluded,
        "seen": terms.seen,
        "texture_complete": 1.0 - terms.missing,
        "nothing_foreign": 1.0 - terms.foreign / 25.0,
        "detail": terms.detail,
        "detail_seen": max(terms.detail, 0.0) * float(np.sqrt(terms.pixels / 1000.0)),
        "same_hues": 1.0 - terms.turned,
        "same_way": 1.0 - terms.otherwise,
        "agreed": terms.agreed,
        "same_size": -min(abs(terms.scale_residual), MOST_SIZE),
        "near_size": -min(abs(terms.scale_residual), MOST_NEAR_SIZE),
        "size": float(np.log10(max(terms.pixels, 1.0))),
    }


def fit_of(entry: Mapping[str, Any]) -> QualityFit:
    """The fit of a method, as `fits.json` has it."""
    logistics = {
        name: Logistic(**entry[name]) for name in ("presence", "this_texture", "this_size", "listed")
    }
    return QualityFit(**{**entry, **logistics})


@cache
def quality_fits() -> dict[str, QualityFit]:
    """The calibrated fits by method."""
    return {method: fit_of(entry) for method, entry in fitted("quality").items()}
