"""Properties of the similarity of colour pairs, whatever the pairs."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from huepose.colorpair.similarity import paired_similarity

colors = arrays(np.float32, (2, 3), elements=st.floats(-60, 60, width=32)).map(
    lambda c: np.concatenate([np.abs(c[:, :1]) * 1.5 + 5, c[:, 1:]], 1).astype(np.float32)
)


@given(colors, colors)
@settings(max_examples=60, deadline=None)
def test_symmetric_bounded_and_independent_of_order(a: np.ndarray, b: np.ndarray) -> None:
    s = paired_similarity(a[None], b[None])[0]
    assert 0.0 <= s <= 1.0
    np.testing.assert_allclose(s, paired_similarity(b[None], a[None])[0], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(s, paired_similarity(a[None, ::-1], b[None])[0], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(s, paired_similarity(a[None], b[None, ::-1])[0], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(paired_similarity(a[None], a[None])[0], 1.0, atol=1e-5)


def lab_of_linear(rgb: np.ndarray) -> np.ndarray:
    """CIELAB of linear RGB colours (..., 3) in 0..1."""
    srgb = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    return cv2.cvtColor(srgb.reshape(1, -1, 3).astype(np.float32), cv2.COLOR_RGB2Lab).reshape(rgb.shape)


def test_exposure_hardly_matters() -> None:
    rng = np.random.default_rng(0)
    linear = rng.uniform(0.03, 0.45, (300, 2, 3))
    before = lab_of_linear(linear)
    for gain in (0.5, 0.7, 1.5, 2.2):
        same = paired_similarity(before, lab_of_linear(linear * gain))
        assert same.min() > 0.97
    other = paired_similarity(before, np.roll(before, 1, axis=0))
    assert np.median(other) < 0.2


def test_each_factor_counts() -> None:
    base = np.array([[[40, 30, 20], [70, -20, 10]]], np.float32)

    def to(other: list[list[float]]) -> float:
        return float(paired_similarity(base, np.array([other], np.float32))[0])

    assert to([[40, 30, 20], [70, -20, 10]]) > 0.999
    assert to([[40, -30, 20], [70, -20, 10]]) < 0.2  # another hue: directional alignment
    assert to([[70, 38, 25], [40, -15, 7]]) < 0.3  # light where it was dark: relative luminance
    assert to([[55, 6, 15], [55, 4, 14]]) < 0.5  # no contrast left
