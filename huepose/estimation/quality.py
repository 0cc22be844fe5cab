"""How far a pose may be trusted: a probability that it is right, and a covariance.

Quality is a logistic function of the margin to the second, different pose and of the score, fitted on
calibration frames; the covariance is that of a robust point-to-plane fit, widened by what print and model
fix and by a floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.registration.surface_icp import Alignment

MAX_MARGIN = 0.4
"""Beyond this a larger margin says nothing more; also the margin of a pose without any other."""


@dataclass(frozen=True)
class QualityFit:
    """Logit of quality: `constant + per_margin * margin + per_score * score`."""

    constant: float = -5.12
    per_margin: float = 18.2
    per_score: float = 2.93


def quality(score: float, margin: float, fit: QualityFit | None = None) -> float:
    """Probability in 0..1 that a pose with this score and margin is right.

    >>> quality(2.4, 0.3) > 0.99 > quality(1.5, 0.02)
    True
    """
    fit = fit or QualityFit()
    x = fit.constant + fit.per_margin * min(max(margin, 0.0), MAX_MARGIN) + fit.per_score * score
    return float(1.0 / (1.0 + np.exp(-x)))


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
