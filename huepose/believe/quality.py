"""Quality: the probability that a pose is right.

It is the product of three probabilities: that the visible texture is this one, not another on the same shape;
that the object has this size; and that the pose is right then. The last one is shared: the probability that
any of the found poses is right is divided among them by their scores, so a near tie is published as one, each
pose with its probability. Whether the object is there at all is a question of its own, which decides whether
it counts as found. The numbers are fitted on rendered scenes (`believe.logistic`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from huepose.believe.logistic import Logistic, fitted
from huepose.geometry.arrays import Float64

# Bounds of terms. Part of the fit: another value needs a new one (`studies.quality`).
# Chosen before the fit.

MOST_MARGIN = 0.3
"""Most difference of totals to the next different pose; also the margin of a pose without any other."""

MOST_SIZE, MOST_NEAR_SIZE = 0.15, 0.05
"""Most scale residual, for whether the size is right, and for whether the object is there at all: points that
are not of the object can cause this much."""

TIE = 0.02
"""Gaps of totals much smaller than this are ties, in which chance decides which pose is first."""


@dataclass(frozen=True)
class QualityTerms:
    """The inputs of quality. total: score of the pose; gaps: how much less the other poses score, best first;
    color, box_iou, depth_fit, coverage, violation, occluded, seen: terms of its dense score (see
    `judge.terms.Terms`); missing, foreign, detail, turned: see `texture_evidence.TextureEvidence`;
    scale_residual: by how much the depth suggests a larger object (see `refine.final`); pixels: number of
    pixels believed to show the object; otherwise: share of the contrasts at the model's pairs that point in
    another colour; agreed: the evidence of those that agree (both `judge.texture_evidence`)."""

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
        """Difference to the best other pose, at most MOST_MARGIN, and MOST_MARGIN without another."""
        return min(max(self.gaps[0], 0.0), MOST_MARGIN) if self.gaps else MOST_MARGIN


@dataclass(frozen=True)
class QualityFit:
    """Each a probability: presence: that the object is there, in whatever texture; this_texture, this_size:
    that it is not another texture or another size of it; listed: that one of the poses is right. The poses
    share it by exp(-sharpness x gap), where sharpness is a constant and a factor times each feature. All but
    the best are lowered further, by exp(-handicap) where they are clearly behind and by nothing where they
    are not (`behind`). level: the quality above which 99 % of the poses of the calibration scenes were right;
    found: the presence below which nothing is found."""

    presence: Logistic
    this_texture: Logistic
    this_size: Logistic
    listed: Logistic
    sharpness: Mapping[str, float]
    handicap: float
    level: float
    found: float

    def probabilities(self, terms: QualityTerms) -> Float64:
        """Probabilities (1 + K,) that the pose, or each other one, is right; their sum is at most 1."""
        known = features(terms)
        known["constant"] = 1.0
        sharpness = sum(factor * max(known[name], 0.0) for name, factor in self.sharpness.items())
        one_of_them = self.this_texture(known) * self.this_size(known) * self.listed(known)
        return np.asarray(one_of_them * shares(terms, sharpness, self.handicap))

    def present(self, terms: QualityTerms) -> float:
        """Probability in 0..1 that the object is there at all."""
        return self.presence(features(terms))


def shares(terms: QualityTerms, sharpness: float, handicap: float) -> Float64:
    """Shares (1 + K,) of the pose and the other ones; their sum is 1.

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
    """How clearly poses with these gaps, of any shape, are behind: 0 for a tie, 1 for a clear second."""
    return np.asarray(np.tanh(gaps / TIE))


def features(terms: QualityTerms) -> dict[str, float]:
    """The terms as they enter a logit: for each of them, larger is more probable."""
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
    """The fit of a method, from its entry in `fits.json`."""
    logistics = {
        name: Logistic(**entry[name]) for name in ("presence", "this_texture", "this_size", "listed")
    }
    return QualityFit(**{**entry, **logistics})


@cache
def quality_fits() -> dict[str, QualityFit]:
    """The calibrated fits by method."""
    return {method: fit_of(entry) for method, entry in fitted("quality").items()}
