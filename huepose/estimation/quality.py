"""How far a pose may be trusted: a probability that it is right, and a covariance.

Quality is a logistic function of the margin to the second, different pose and of the score and its terms,
fitted on calibration frames; the covariance is that of a robust point-to-plane fit, widened by what print
and model fix and by a floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.registration.surface_icp import Alignment

MAX_MARGIN = 0.3
"""Beyond this a larger margin says nothing more; also the margin of a pose without any other."""


@dataclass(frozen=True)
class QualityFit:
    """Logit of quality: a constant, and factors of margin, total, colour and box IoU."""

    constant: float
    margin: float
    score: float
    color: float = 0.0
    box: float = 0.0


QUALITY_FITS = {
    "full": QualityFit(-11.64, 8.66, 2.92, 3.50, 5.63),
    "colorpair": QualityFit(-5.12, 18.2, 2.93),
}
"""By method; that of `full` on clean, cluttered and piled scenes and on boxes that hold another object."""


def quality(method: str, total: float, margin: float, color: float, box_iou: float) -> float:
    """Probability in 0..1 that a pose is right: of its total, the margin to the next pose, and the terms
    `color` and `box_iou` of its dense score.

    >>> quality("full", 2.4, 0.3, 0.6, 0.9) > 0.98 > 0.1 > quality("full", 1.3, 0.02, 0.2, 0.5)
    True
    """
    fit = QUALITY_FITS[method]
    x = fit.constant + fit.margin * min(max(margin, 0.0), MAX_MARGIN) + fit.score * total
    x += fit.color * color + fit.box * box_iou
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
