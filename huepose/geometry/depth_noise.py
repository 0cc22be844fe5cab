"""How exact a depth reading is: the noise model that gates, tolerances and covariances follow from."""

from __future__ import annotations

STEREO_NOISE_PER_M = 0.0027
"""RMS error of an active stereo camera of the D435 class is this times the square of the distance (metres):
subpixel error 0.08 px over focal length 600 px times baseline 5 cm."""

FLOOR_M = 0.0005
"""What better sensors, calibration and scanned models leave."""

POINTS_PER_READING = 6.0
"""Stereo matches windows, so neighbouring pixels err alike: so many points of an object count as one."""


def depth_noise_m(distance_m: float) -> float:
    """RMS error of a depth reading at a distance, metres.

    >>> round(1000 * depth_noise_m(0.7), 2)
    1.82
    """
    return FLOOR_M + STEREO_NOISE_PER_M * distance_m**2
