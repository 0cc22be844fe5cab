"""Edges of known position, direction and blur are found where they are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from huepose.colorpair import ridges as module
from huepose.colorpair.ridges import Ridges, find_ridges, long_enough, unified_gradient
from tests.kernels import compiled


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


def edge(angle: float, offset: float, blur: float, size: int = 60, height: float = 60.0) -> np.ndarray:
    """CIELAB image with a step of L across a line: n . (u - c, v - c) = offset, n at `angle`, blurred."""
    v, u = np.mgrid[0:size, 0:size] - (size - 1) / 2
    distance = np.cos(angle) * u + np.sin(angle) * v - offset
    lab = np.zeros((size, size, 3), np.float32)
    lab[..., 0] = 20 + height / 2 * (1 + erf(distance / (np.sqrt(2) * max(blur, 1e-3))))
    return lab


def inner(ridges: Ridges, size: int = 60, margin: int = 8) -> np.ndarray:
    return (np.abs(ridges.pixels - (size - 1) / 2) < size / 2 - margin).all(1)


@pytest.mark.parametrize("angle_deg", [0.0, 17.0, 45.0, 63.0, 90.0, 121.0, 180.0, 250.0])
@pytest.mark.parametrize("offset", [0.0, 0.3, 1.4])
def test_position_and_direction(angle_deg: float, offset: float) -> None:
    angle = np.radians(angle_deg)
    ridges = find_ridges(unified_gradient(edge(angle, offset, blur=1.5)))
    ridges_in = inner(ridges)
    assert ridges_in.sum() > 30
    n = np.array([np.cos(angle), np.sin(angle)])
    place = (ridges.pixels[ridges_in] - 29.5) @ n
    assert abs(place.mean() - offset) < 0.05
    assert np.abs(place - offset).max() < 0.15
    assert ((ridges.directions[ridges_in] @ n) > np.cos(np.radians(3.0))).all()


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 45.0])
def test_lines_are_one_pixel_wide(angle_deg: float) -> None:
    angle = np.radians(angle_deg)
    ridges = find_ridges(unified_gradient(edge(angle, 0.2, blur=1.0)))
    along = np.argmax(np.abs([np.sin(angle), np.cos(angle)]))
    _, counts = np.unique(ridges.cells[:, 1 - along], return_counts=True)
    assert (counts == 1).mean() > 0.9


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 45.0])
def test_thickness_is_sharpness_not_contrast(angle_deg: float) -> None:
    angle = np.radians(angle_deg)

    def thickness(blur: float, height: float = 60.0) -> float:
        ridges = find_ridges(unified_gradient(edge(angle, 0.0, blur, height=height)))
        return float(np.median(ridges.widths[inner(ridges)]))

    # a Gaussian falls to 0.3 of its peak 1.55 deviations out
    for blur in (1.5, 2.0, 3.0):
        assert thickness(blur) == pytest.approx(3.1 * np.sqrt(blur**2 + 0.6), rel=0.15)
    assert thickness(2.0, height=70.0) == pytest.approx(thickness(2.0, height=35.0), rel=0.1)
    assert thickness(0.0) < thickness(1.0) < thickness(2.0) < thickness(3.0)


def test_mask_and_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    lab = edge(0.0, 0.0, 1.0)
    mask = np.zeros((60, 60), bool)
    mask[:20] = True
    assert (find_ridges(unified_gradient(lab), mask).cells[:, 0] < 20).all()
    rng = np.random.default_rng(0)
    noisy = np.full((80, 80, 3), 50, np.float32) + rng.normal(0, 2.0, (80, 80, 3)).astype(np.float32)
    found = len(find_ridges(unified_gradient(noisy)))
    monkeypatch.setattr(module, "NOISE_FACTOR", 0.0)
    monkeypatch.setattr(module, "MIN_LENGTH", 1)
    careless = len(find_ridges(unified_gradient(noisy)))
    assert found < 0.25 * careless


def test_short_lines_are_dropped() -> None:
    lines = np.zeros((10, 20), bool)
    lines[2, 2:5] = True
    lines[6, 2:12] = True
    assert long_enough(lines).sum() == 10


def test_a_black_image_compiles_no_kernel_again() -> None:
    assert len(find_ridges(unified_gradient(edge(0.0, 0.0, 1.0)))) > 0
    before = compiled()
    black = np.zeros((60, 60, 3), np.float32)
    assert len(find_ridges(unified_gradient(black))) == 0
    assert compiled() == before
