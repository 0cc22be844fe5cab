"""A change of light acts on CIELAB as gains on the cube roots of XYZ; known gains are found."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from huepose.paper.extended.light import cube_roots, lab_of, lights_of, relit


def textures(seed: int) -> np.ndarray:
    """300 pairs of six texture colours, each a little uneven."""
    rng = np.random.default_rng(seed)
    inks = np.array([[85, 2, 5], [30, 5, -30], [45, 55, 35], [80, -5, 70], [25, 0, 0], [55, -35, 25]])
    which = np.array([rng.choice(6, 2, replace=False) for _ in range(300)])
    return (inks[which] + rng.normal(0, 2.0, (300, 2, 3))).astype(np.float32)


@pytest.mark.parametrize("gain", [(1.0, 1.0, 1.0), (0.72, 0.7, 0.66), (0.9, 0.87, 0.75), (1.22, 1.2, 1.3)])
def test_the_gains_of_a_light_are_found(gain: tuple[float, float, float]) -> None:
    model = textures(0)
    rng = np.random.default_rng(1)
    scene = relit(textures(2)[:120], np.array(gain))
    scene[:40] = rng.uniform([10, -40, -40], [90, 40, 40], (40, 2, 3))  # a third belongs to something else
    scene = np.where(rng.random((120, 1, 1)) < 0.5, scene, scene[:, ::-1]).astype(np.float32)
    light, share = lights_of(scene, model, np.random.default_rng(0))[0]
    np.testing.assert_allclose(light, gain, rtol=0.06)
    assert 0.4 < share < 0.95


def test_lights_are_different_and_best_first() -> None:
    found = lights_of(textures(2), textures(0), np.random.default_rng(0))
    shares = [share for _, share in found]
    assert shares == sorted(shares, reverse=True)
    for (a, _), (b, _) in pairwise(found):
        assert np.abs(np.log(a / b)).max() > 0.12


def test_without_pairs_the_light_is_unchanged() -> None:
    none = np.zeros((0, 2, 3), np.float32)
    light, share = lights_of(none, textures(0), np.random.default_rng(0))[0]
    np.testing.assert_array_equal(light, 1.0)
    assert share == 0.0


def test_conversions_are_inverted() -> None:
    rng = np.random.default_rng(0)
    lab = np.stack([rng.uniform(5, 95, 50), rng.normal(0, 20, 50), rng.normal(0, 20, 50)], 1)
    np.testing.assert_allclose(lab_of(cube_roots(lab)), lab, atol=1e-4)
    gain = np.array([0.8, 0.9, 1.2])
    np.testing.assert_allclose(relit(relit(lab, gain), 1 / gain), lab, atol=1e-3)


def test_white_has_cube_roots_of_one() -> None:
    np.testing.assert_allclose(cube_roots(np.array([100.0, 0.0, 0.0])), [1.0, 1.0, 1.0])


def test_a_gain_in_linear_light_acts_as_its_cube_root() -> None:
    xyz = np.array([[0.3, 0.25, 0.1], [0.5, 0.6, 0.4]])
    lab = lab_of(np.cbrt(xyz))
    gain = np.array([1.3, 0.7, 2.0])
    np.testing.assert_allclose(relit(lab, np.cbrt(gain)), lab_of(np.cbrt(xyz * gain)), atol=1e-3)
