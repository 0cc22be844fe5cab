"""How much a depth reading errs: one model for everything that weighs depth.

Stereo measures disparity, so its depth errs with the square of the distance: sigma = z^2 * d / (f * B) for an
error of d pixels in disparity (Grunnet-Jepsen et al., Tuning depth cameras for best performance). A constant
stands for quantisation and for sensors that have no such term.
"""

from __future__ import annotations

DEPTH_FLOOR_M = 0.0005
"""Half a step of depth in whole millimetres."""

STEREO_SIGMA_PER_M = 0.0027
"""Metres at one metre: a D435 at 848 x 480 (f 424 px, B 50 mm) with 0.057 px of error in disparity."""

POINTS_PER_READING = 6.0
"""Stereo matches windows, so neighbouring pixels err alike: so many points of an object count as one."""


def depth_sigma_m(distance_m: float) -> float:
    """Standard deviation of one reading, metres.

    >>> [round(1e3 * depth_sigma_m(z), 2) for z in (0.0, 0.5, 1.0, 2.0)]
    [0.5, 1.18, 3.2, 11.3]
    """
    return DEPTH_FLOOR_M + STEREO_SIGMA_PER_M * distance_m**2
