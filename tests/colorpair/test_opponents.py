"""Opponents: light is an offset, shading is lightness alone."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.colorpair.opponents import DARKEST, LINEAR, SCALE, opponents, opponents_of_lab


def test_a_coloured_light_adds_constants() -> None:
    rng = np.random.default_rng(0)
    surfaces = rng.uniform(0.2, 0.9, (200, 3))
    light = np.array([0.9, 0.6, 0.5])
    change = opponents(surfaces * light) - opponents(surfaces)
    expected = SCALE * np.log(light)
    assert np.abs(change[:, 0] - expected.mean()).max() < 2.5  # DARKEST bends the darkest a little
    assert np.abs(change[:, 1] - (expected[0] - expected[1])).max() < 1.5
    assert change.std(0).max() < 0.6


def test_shading_changes_lightness_alone() -> None:
    surface = np.array([0.6, 0.4, 0.3])
    shades = opponents(surface * np.linspace(0.5, 1.0, 20)[:, None])
    assert np.ptp(shades[:, 0]) > 15
    assert np.ptp(shades[:, 1]) < 0.5
    assert np.ptp(shades[:, 2]) < 0.5


def test_bytes_and_lab_of_the_same_colour_agree() -> None:
    color = np.random.default_rng(1).integers(40, 256, (1, 300, 3), dtype=np.uint8)
    lab = cv2.cvtColor(color.astype(np.float32) / 255, cv2.COLOR_RGB2Lab)
    assert np.abs(opponents(LINEAR[color]) - opponents_of_lab(lab)).max() < 0.3


def test_black_is_finite() -> None:
    assert np.allclose(opponents(np.zeros((2, 3))), [SCALE * np.log(DARKEST), 0, 0], atol=1e-4)
