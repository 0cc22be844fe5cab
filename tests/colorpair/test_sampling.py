"""A step of known colours gives those colours, with noise, neighbours and a mask."""

from __future__ import annotations

import numpy as np

from huepose.colorpair.ridges import find_ridges, unified_gradient
from huepose.colorpair.sampling import sample_sides

LEFT, RIGHT = np.array([30.0, 25.0, -20.0]), np.array([70.0, -10.0, 35.0])


def step(size: int = 60, at: int = 30) -> np.ndarray:
    lab = np.empty((size, size, 3), np.float32)
    lab[:, :at], lab[:, at:] = LEFT, RIGHT
    return lab


def test_two_colours_in_the_order_of_the_direction() -> None:
    lab = step()
    ridges = find_ridges(unified_gradient(lab))
    colors, valid = sample_sides(lab, ridges)
    assert valid.sum() > 40
    rising = ridges.directions[valid, 0] > 0
    first, second = np.where(rising[:, None], LEFT, RIGHT), np.where(rising[:, None], RIGHT, LEFT)
    np.testing.assert_allclose(colors[valid, 0], first, atol=0.5)
    np.testing.assert_allclose(colors[valid, 1], second, atol=0.5)


def test_noise_is_averaged_away() -> None:
    rng = np.random.default_rng(1)
    lab = step() + rng.normal(0, 3, (60, 60, 3)).astype(np.float32)
    ridges = find_ridges(unified_gradient(lab))
    near = np.abs(ridges.pixels[:, 0] - 29.5) < 1
    colors, valid = sample_sides(lab, ridges)
    ok = near & valid
    rising = ridges.directions[ok, 0] > 0
    truth = np.where(rising[:, None, None], np.stack([LEFT, RIGHT]), np.stack([RIGHT, LEFT]))
    assert np.abs(np.median(colors[ok] - truth, axis=0)).max() < 0.7
    assert (colors[ok] - truth).std() < 2.2  # single pixels have 3


def test_a_speck_on_the_profile_is_gated() -> None:
    lab = step()
    lab[:, 33] = (95.0, 0.0, 0.0)  # a thin bright line beside the edge
    ridges = find_ridges(unified_gradient(lab))
    at_edge = np.abs(ridges.pixels[:, 0] - 29.5) < 0.6
    colors, valid = sample_sides(lab, ridges)
    ok = at_edge & valid & (ridges.directions[:, 0] > 0)
    assert ok.sum() > 20
    assert np.abs(colors[ok, 1] - RIGHT).max() < 6.0


def test_both_sides_must_lie_in_the_mask() -> None:
    lab = step()
    ridges = find_ridges(unified_gradient(lab))
    mask = np.ones((60, 60), bool)
    mask[:, 31:] = False
    assert not sample_sides(lab, ridges, mask)[1].any()


def test_thinning_keeps_the_first_and_the_limit() -> None:
    lab = step()
    ridges = find_ridges(unified_gradient(lab))
    every = sample_sides(lab, ridges)[1]
    colors, kept = sample_sides(lab, ridges, spacing=3.5)
    places = ridges.pixels[kept]
    apart = np.linalg.norm(places[:, None] - places, axis=-1) + 100.0 * np.eye(len(places))
    assert apart.min() >= 3.5
    assert kept.argmax() == every.argmax()
    assert np.linalg.norm(ridges.pixels[every][:, None] - places, axis=-1).min(1).max() < 3.5
    np.testing.assert_array_equal(colors[kept], sample_sides(lab, ridges)[0][kept])
    assert 5 < sample_sides(lab, ridges, spacing=3.5, limit=10)[1].sum() <= 10


def test_two_colours_that_are_nearly_one_are_no_pair() -> None:
    lab = step()
    ridges = find_ridges(unified_gradient(lab))
    faint = LEFT.astype(np.float32) + 0.05 * (lab - LEFT.astype(np.float32))
    assert not sample_sides(faint, ridges)[1].any()
