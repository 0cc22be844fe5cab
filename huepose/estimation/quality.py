"""How far a pose may be trusted: a probability that it is right, and a covariance.

Quality is a logistic function of a few terms of the estimate, above all of the margin to the second,
different pose; `quality_fits.json` holds it, as `huepose eval calibrate` fitted it on rendered scenes. The
covariance is that of a robust point-to-plane fit, widened by what print and model fix and by a floor.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.registration.surface_icp import Alignment

MAX_MARGIN = 0.3
"""Beyond this a larger margin says nothing more; also the margin of a pose without any other."""


@dataclass(frozen=True)
class QualityTerms:
    """What quality is a function of. total: score of the pose; margin: to the best clearly different pose;
    color, box_iou, depth_fit, coverage, violation, occluded, seen: terms of its dense score (see
    `verification.dense.PoseScore`); pixels: of the image that are believed to show the object."""

    total: float
    margin: float
    color: float
    box_iou: float
    depth_fit: float
    coverage: float
    violation: float
    occluded: float
    seen: float
    pixels: float


@dataclass(frozen=True)
class QualityFit:
    """Logit of quality: a constant, and a factor for each feature; level: the quality over which 99 % of the
    poses of the calibration scenes were right."""

    constant: float
    factors: Mapping[str, float]
    level: float

    def __call__(self, terms: QualityTerms) -> float:
        """Probability in 0..1."""
        found = features(terms)
        x = self.constant + sum(factor * found[name] for name, factor in self.factors.items())
        return float(1.0 / (1.0 + np.exp(-min(max(x, -30.0), 30.0))))


def features(terms: QualityTerms) -> dict[str, float]:
    """The terms in the form in which they enter the logit: the larger, the surer, for every one of them."""
    margin = min(max(terms.margin, 0.0), MAX_MARGIN)
    return {
        "margin": margin,
        "small_margin": min(margin, 0.08),
        "total": terms.total,
        "color": terms.color,
        "box_iou": terms.box_iou,
        "depth_fit": terms.depth_fit,
        "coverage": terms.coverage,
        "no_violation": 1.0 - terms.violation,
        "not_occluded": 1.0 - terms.occluded,
        "seen": terms.seen,
        "size": float(np.log(max(terms.pixels, 1.0)) / np.log(10.0)),
    }


@cache
def quality_fits() -> dict[str, QualityFit]:
    """The calibrated fits by method."""
    text = resources.files("huepose.estimation").joinpath("quality_fits.json").read_text()
    return {method: QualityFit(**entry) for method, entry in json.loads(text).items()}


def quality(method: str, terms: QualityTerms) -> float:
    """Probability in 0..1 that a pose of this method is right.

    >>> sure = QualityTerms(2.4, 0.3, 0.6, 0.9, 0.9, 0.9, 0.02, 0.1, 0.9, 4000)
    >>> doubtful = QualityTerms(1.3, 0.01, 0.2, 0.5, 0.5, 0.4, 0.2, 0.3, 0.4, 500)
    >>> quality("full", sure) > 0.9 > 0.3 > quality("full", doubtful)
    True
    """
    return quality_fits()[method](terms)


POINTS_PER_READING = 6.0
"""Neighbouring depth pixels err alike: this many of them count as one."""

DEPTH_SIGMA_M = 0.0005
PRINT_SIGMA = np.array([0.004, 0.004, 0.004, 0.05, 0.05, 0.05])
"""What the print still fixes where depth fixes nothing (metres, radians)."""

FLOOR_SIGMA = np.array([0.0005, 0.0005, 0.0010, 0.006, 0.006, 0.006])
"""Errors of model and calibration, which no number of points averages away."""


def covariance(alignment: Alignment) -> Float64:
    """Covariance (6, 6) of a pose from the point-to-plane fit at it; order tx ty tz rx ry rz, camera axes."""
    variance = (alignment.rms_m**2 + DEPTH_SIGMA_M**2) * POINTS_PER_READING
    information = alignment.information / variance + np.diag(1.0 / PRINT_SIGMA**2)
    return np.asarray(np.linalg.inv(information) + np.diag(FLOOR_SIGMA**2))
