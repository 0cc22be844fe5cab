"""Extraction as a whole: a square gives its outline and its two colours at any scale."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from huepose.colorpair.extract import denoise, extract, joint_bilateral, to_lab


def test_a_constant_image_is_unchanged() -> None:
    color = np.full((20, 30, 3), (200, 90, 40), np.uint8)
    np.testing.assert_allclose(denoise(color), to_lab(color), atol=1e-3)


def test_chroma_noise_is_reduced_and_the_edge_stays() -> None:
    rng = np.random.default_rng(0)
    clean = np.zeros((60, 60, 3), np.float32)
    clean[:, :30] = (35, 20, -10)
    clean[:, 30:] = (75, -15, 30)
    noisy = clean.copy()
    noisy[..., 1:] += rng.normal(0, 6, noisy[..., 1:].shape).astype(np.float32)
    out = joint_bilateral(noisy)
    np.testing.assert_array_equal(out[..., 0], noisy[..., 0])
    assert (out - clean)[..., 1:].std() < 0.45 * (noisy - clean)[..., 1:].std()
    # lightness guides: the columns at the edge keep their own side's colours
    np.testing.assert_allclose(out[:, 29, 1:].mean(0), clean[0, 29, 1:], atol=1.5)
    np.testing.assert_allclose(out[:, 30, 1:].mean(0), clean[0, 30, 1:], atol=1.5)


def test_without_a_lightness_edge_chroma_is_blurred() -> None:
    lab = np.full((20, 20, 3), 50, np.float32)
    lab[:, 10:, 1] = 80
    out = joint_bilateral(lab)
    assert 50 < out[10, 9, 1] < 65 < out[10, 10, 1] < 80


RED, BLUE = (200, 40, 30), (30, 60, 180)


def square(noise: float = 0.0) -> np.ndarray:
    """240 x 320, blue, with a red square from 100 to 180 (u) and 80 to 160 (v), with sharp edges."""
    color = np.full((240, 320, 3), BLUE, np.float32)
    color[80:160, 100:180] = RED
    if noise:
        color += np.random.default_rng(0).normal(0, noise, color.shape)
    return np.clip(color, 0, 255).astype(np.uint8)


def distance_to_outline(pixels: np.ndarray) -> np.ndarray:
    """Distance of pixels (N, 2) to the square's outline, whose sides lie between pixels."""
    q = np.abs(pixels - [139.5, 119.5]) - 40.0
    outside = np.linalg.norm(np.maximum(q, 0), axis=1)
    return np.abs(outside + np.minimum(q.max(1), 0))


@pytest.mark.parametrize("scale", [1.0, 0.5])
@pytest.mark.parametrize("noise", [0.0, 8.0])
def test_outline_and_colours_of_a_square(scale: float, noise: float) -> None:
    pairs = extract(square(noise), scale=scale)
    assert len(pairs) > 50
    assert np.median(distance_to_outline(pairs.pixels)) < 0.3 / scale
    assert (distance_to_outline(pairs.pixels) < 1.5 / scale).mean() > 0.95
    red, blue = to_lab(np.array([[RED, BLUE]], np.uint8))[0]
    # side 1 lies along the direction
    ahead = pairs.pixels + 5 * np.stack([np.cos(pairs.directions), np.sin(pairs.directions)], 1)
    inward = (np.abs(ahead - [139.5, 119.5]) < 40).all(1)
    sides = np.where(inward[:, None, None], np.stack([blue, red]), np.stack([red, blue]))
    assert np.median(np.abs(pairs.colors - sides)) < (0.5 if noise == 0 else 2.0)


def test_a_mask_keeps_both_sides_inside() -> None:
    mask = np.zeros((240, 320), bool)
    mask[60:180, 60:140] = True
    pairs = extract(square(), mask)
    assert len(pairs) > 20
    assert (pairs.pixels[:, 0] < 139.6).all()
    assert len(extract(square(), np.zeros((240, 320), bool))) == 0
    inner = np.zeros((240, 320), bool)
    inner[90:150, 110:170] = True
    assert len(extract(square(), inner)) == 0


def test_a_gain_of_light_does_not_move_the_pairs() -> None:
    color = square(2.0)
    dim = cv2.convertScaleAbs(color, alpha=0.6)
    bright, dark = extract(color), extract(dim)
    assert len(dark) == pytest.approx(len(bright), rel=0.2)
    assert (distance_to_outline(dark.pixels) < 1.5).mean() > 0.95


def test_tiny_images_have_no_pairs() -> None:
    assert len(extract(np.zeros((4, 4, 3), np.uint8))) == 0
    assert len(extract(np.full((30, 30, 3), 90, np.uint8))) == 0


def painted(edges: list[tuple[float, tuple[int, int, int]]], angle: float, blur: float) -> np.ndarray:
    """Stripes in 120 x 120 px across a line at `angle`, each from its offset on; painted finer and scaled
    down."""
    fine = 8
    v, u = (np.mgrid[0 : 120 * fine, 0 : 120 * fine] + 0.5) / fine - 60.0
    across = np.cos(angle) * u + np.sin(angle) * v
    color = np.empty((*across.shape, 3), np.float32)
    for offset, paint in edges:
        color[across >= offset] = paint
    small = cv2.resize(color, (120, 120), interpolation=cv2.INTER_AREA)
    return np.rint(cv2.GaussianBlur(small, (0, 0), blur) if blur else small).astype(np.uint8)


@pytest.mark.parametrize("angle_deg", [0.0, 28.0, 45.0, 77.0, 130.0])
@pytest.mark.parametrize("blur", [0.0, 1.0, 2.0])
def test_an_edge_of_known_position_direction_and_blur(angle_deg: float, blur: float) -> None:
    angle, offset = np.radians(angle_deg), 0.37
    color = painted([(-1e3, (60, 60, 70)), (offset, (190, 180, 120))], angle, blur)
    pairs = extract(color)
    inner = (np.abs(pairs.pixels - 59.5) < 45).all(1)
    assert inner.sum() > 15
    way = np.array([np.cos(angle), np.sin(angle)])
    place = (pairs.pixels[inner] - 59.5) @ way
    # denoising pulls a pixel on the edge to its nearer side, so positions are exact to a third of a pixel
    assert abs(np.median(place) - offset) < 0.33
    assert np.abs(place - offset).max() < 0.6
    turn = np.angle(np.exp(1j * (pairs.directions[inner] - angle)))
    assert np.abs(np.degrees(turn)).max() < 10.0  # from dark to light
    widths = np.median(pairs.widths[inner])
    # the pixel's step, Scharr's kernel and the blur, to 0.3 of the peak on both sides; denoising sharpens
    assert 0.6 < widths / (3.1 * np.sqrt(blur**2 + 0.7)) < 1.3


@pytest.mark.parametrize("noise", [0.0, 6.0])
def test_a_third_colour_nearby_does_not_mix_in(noise: float) -> None:
    """A stripe of 7 px between two others: both edges give the stripe's colour on their inner side."""
    paints = [(60, 90, 160), (220, 200, 60), (150, 40, 60)]
    color = painted([(-1e3, paints[0]), (-3.5, paints[1]), (3.5, paints[2])], np.radians(20.0), 0.6)
    color = np.clip(color + np.random.default_rng(0).normal(0, noise, color.shape), 0, 255).astype(np.uint8)
    pairs = extract(color)
    way = np.array([np.cos(np.radians(20.0)), np.sin(np.radians(20.0))])
    place = (pairs.pixels - 59.5) @ way
    truth = to_lab(np.array([paints], np.uint8))[0]
    inner = (np.abs(pairs.pixels - 59.5) < 40).all(1)
    for offset, (low, high) in ((-3.5, (0, 1)), (3.5, (1, 2))):
        chosen = inner & (np.abs(place - offset) < 1.0)
        assert chosen.sum() > 15
        rising = np.cos(pairs.directions[chosen] - np.radians(20.0)) > 0
        ends = np.stack([truth[low], truth[high]])
        wanted = np.where(rising[:, None, None], ends, ends[::-1])
        off = np.linalg.norm(pairs.colors[chosen] - wanted, axis=2)
        assert np.median(off) < 6.0  # the colours lie 60 to 100 apart
