"""Gains on the cube roots of XYZ are what a change of light does to CIELAB."""

from __future__ import annotations

import numpy as np

from huepose.paper.extended.light import cube_roots, lab_of, relit


def test_round_trips() -> None:
    rng = np.random.default_rng(0)
    lab = np.stack([rng.uniform(5, 95, 50), rng.normal(0, 20, 50), rng.normal(0, 20, 50)], 1)
    np.testing.assert_allclose(lab_of(cube_roots(lab)), lab, atol=1e-4)
    gain = np.array([0.8, 0.9, 1.2])
    np.testing.assert_allclose(relit(relit(lab, gain), 1 / gain), lab, atol=1e-3)


def test_white_has_roots_of_one() -> None:
    np.testing.assert_allclose(cube_roots(np.array([100.0, 0.0, 0.0])), [1.0, 1.0, 1.0])


def test_a_gain_in_linear_light_is_its_cube_root_here() -> None:
    xyz = np.array([[0.3, 0.25, 0.1], [0.5, 0.6, 0.4]])
    lab = lab_of(np.cbrt(xyz))
    gain = np.array([1.3, 0.7, 2.0])
    np.testing.assert_allclose(relit(lab, np.cbrt(gain)), lab_of(np.cbrt(xyz * gain)), atol=1e-3)
