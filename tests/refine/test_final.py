"""How exact a pose is, where the answer is known."""

from __future__ import annotations

import numpy as np

from huepose.refine.final import PoseNoise, covariance
from huepose.refine.point_to_plane import Alignment

NOISE = PoseNoise()


def test_where_depth_fixes_nothing_the_texture_does() -> None:
    expected = np.array(NOISE.texture_sigma) ** 2 + np.array(NOISE.floor_sigma) ** 2
    np.testing.assert_allclose(covariance(fitted(np.zeros((6, 6)))), np.diag(expected), rtol=1e-12)


def test_no_number_of_points_averages_the_floor_away() -> None:
    floor = np.diag(np.array(NOISE.floor_sigma) ** 2)
    np.testing.assert_allclose(covariance(fitted(1e15 * np.eye(6))), floor, rtol=1e-6, atol=1e-15)


def test_four_times_the_points_halve_what_depth_leaves_open() -> None:
    noise = PoseNoise(texture_sigma=(1e3,) * 6, floor_sigma=(0.0,) * 6)
    few, many = (np.sqrt(np.diag(covariance(fitted(n * np.eye(6)), noise))) for n in (1e4, 4e4))
    np.testing.assert_allclose(few, 2.0 * many, rtol=1e-6)


def fitted(information: np.ndarray) -> Alignment:
    """A fit with these normal equations and residuals of a millimetre."""
    return Alignment(np.eye(4), 10, 100, 100.0, 0.001, information)
