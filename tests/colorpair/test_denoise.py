"""Chroma noise goes, edges and lightness stay."""

from __future__ import annotations

import numpy as np

from huepose.colorpair.denoise import denoise, joint_bilateral, to_lab


def test_a_constant_image_stays_what_it_is() -> None:
    color = np.full((20, 30, 3), (200, 90, 40), np.uint8)
    np.testing.assert_allclose(denoise(color), to_lab(color), atol=1e-3)


def test_chroma_noise_is_divided_and_the_edge_stays() -> None:
    rng = np.random.default_rng(0)
    clean = np.zeros((60, 60, 3), np.float32)
    clean[:, :30] = (35, 20, -10)
    clean[:, 30:] = (75, -15, 30)
    noisy = clean.copy()
    noisy[..., 1:] += rng.normal(0, 6, noisy[..., 1:].shape).astype(np.float32)
    out = joint_bilateral(noisy, 2, 1.5, 6.0)
    np.testing.assert_array_equal(out[..., 0], noisy[..., 0])
    assert (out - clean)[..., 1:].std() < 0.45 * (noisy - clean)[..., 1:].std()
    # lightness guides: the columns at the edge keep their own side's colours
    np.testing.assert_allclose(out[:, 29, 1:].mean(0), clean[0, 29, 1:], atol=1.5)
    np.testing.assert_allclose(out[:, 30, 1:].mean(0), clean[0, 30, 1:], atol=1.5)


def test_without_a_lightness_edge_chroma_is_blurred() -> None:
    lab = np.full((20, 20, 3), 50, np.float32)
    lab[:, 10:, 1] = 80
    out = joint_bilateral(lab, 2, 1.5, 6.0)
    assert 50 < out[10, 9, 1] < 65 < out[10, 10, 1] < 80
