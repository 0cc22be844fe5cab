"""How exact a pose is: the covariance of a robust point-to-plane fit at it, widened by what else is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.depth_noise import FLOOR_M, POINTS_PER_READING
from huepose.refine.point_to_plane import Alignment


@dataclass(frozen=True)
class PoseNoise:
    """What a fit to depth does not know. Metres and radians, camera axes. Origin: chosen.

    points_per_reading: neighbouring depth pixels err alike, so that many of them count as one.
    depth_sigma_m: of a depth reading, beside the residuals of the fit. texture_sigma: what the texture still
    fixes where depth fixes nothing. floor_sigma: errors of model and calibration, which no number of points
    averages away.
    """

    points_per_reading: float = POINTS_PER_READING
    depth_sigma_m: float = FLOOR_M
    texture_sigma: tuple[float, ...] = (0.004, 0.004, 0.004, 0.05, 0.05, 0.05)
    floor_sigma: tuple[float, ...] = (0.0005, 0.0005, 0.0010, 0.006, 0.006, 0.006)


def covariance(alignment: Alignment, noise: PoseNoise | None = None) -> Float64:
    """Covariance (6, 6) of a pose from the point-to-plane fit at it; order tx ty tz rx ry rz, camera axes."""
    noise = noise or PoseNoise()
    variance = (alignment.rms_m**2 + noise.depth_sigma_m**2) * noise.points_per_reading
    texture, floor = np.array(noise.texture_sigma), np.array(noise.floor_sigma)
    information = alignment.information / variance + np.diag(1.0 / texture**2)
    return np.asarray(np.linalg.inv(information) + np.diag(floor**2))
