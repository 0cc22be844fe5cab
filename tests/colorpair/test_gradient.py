"""The unified gradient of ramps whose slopes are known."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.colorpair.gradient import unified_gradient


def ramp(slopes: tuple[tuple[float, float], ...]) -> np.ndarray:
    """An image of 20 x 24 whose channels rise by (du, dv) per pixel."""
    v, u = np.mgrid[0:20, 0:24].astype(np.float32)
    return np.stack([a * u + b * v for a, b in slopes], -1).astype(np.float32)


def test_energy_of_all_channels_direction_of_the_strongest() -> None:
    g = unified_gradient(ramp(((3.0, 0.0), (0.0, 4.0), (0.0, 0.0))))
    np.testing.assert_allclose(g.magnitude[5:-5, 5:-5], 5.0, rtol=1e-4)
    np.testing.assert_allclose(g.direction[10, 10], [0.0, 1.0], atol=1e-5)


@pytest.mark.parametrize("angle", np.radians([0, 30, 75, 140, 250]))
def test_direction_points_up_the_ramp(angle: float) -> None:
    g = unified_gradient(ramp(((5 * np.cos(angle), 5 * np.sin(angle)), (0, 0), (0, 0))))
    np.testing.assert_allclose(g.direction[10, 10], [np.cos(angle), np.sin(angle)], atol=1e-5)


def test_opposite_channels_do_not_cancel() -> None:
    g = unified_gradient(ramp(((0, 0), (6.0, 0), (-6.0, 0))))
    np.testing.assert_allclose(g.magnitude[10, 10], 6 * np.sqrt(2), rtol=1e-4)


def test_flat_has_no_gradient() -> None:
    g = unified_gradient(np.full((10, 10, 3), 40, np.float32))
    assert not g.magnitude.any()
    assert not g.direction.any()
