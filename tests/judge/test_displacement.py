"""A texture glued on a little elsewhere is found there; another texture is not made to fit."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from huepose.geometry.arrays import Float32
from huepose.judge.displacement import SPREAD, aligned

SIDE = 120


def a_texture(seed: int) -> Float32:
    """Detail (SIDE, SIDE, 3) as textures have it: letters of a few pixels, a smooth wide part removed."""
    noise = np.random.default_rng(seed).normal(0.0, 60.0, (SIDE, SIDE, 3)).astype(np.float32)
    fine, wide = cv2.GaussianBlur(noise, (0, 0), 1.2), cv2.GaussianBlur(noise, (0, 0), 4.0)
    return np.asarray(fine - wide, dtype=np.float32)


def carried(texture: Float32, A: np.ndarray) -> Float32:
    """The texture carried along by x -> x + A (x - middle, 1), A (2, 3)."""
    middle = (SIDE - 1) / 2
    forth = np.eye(2) + A[:, :2]
    shift = A[:, 2] - A[:, :2] @ (middle, middle)
    matrix = np.column_stack([forth, shift])
    return np.asarray(cv2.warpAffine(texture, matrix, (SIDE, SIDE)), dtype=np.float32)


def correlation(a: Float32, b: Float32) -> float:
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


EVERYWHERE = np.ones((SIDE, SIDE), dtype=bool)


@pytest.mark.parametrize(
    "A",
    [
        np.array([[0.0, 0.0, 2.5], [0.0, 0.0, -1.5]]),
        np.array([[0.02, -0.015, 0.5], [0.015, 0.02, 1.0]]),
    ],
    ids=["moved", "turned and larger"],
)
def test_a_displaced_texture_is_found(A: np.ndarray) -> None:
    texture = a_texture(1)
    picture = carried(texture, A) * 0.6
    inner = (slice(12, -12), slice(12, -12))
    assert correlation(picture[inner], texture[inner]) < 0.7
    moved = aligned(picture, texture, EVERYWHERE)
    assert correlation(picture[inner], moved[inner]) > 0.95


def test_a_texture_in_its_place_stays_there() -> None:
    texture = a_texture(2)
    assert correlation(aligned(texture, texture, EVERYWHERE), texture) > 0.999


def test_another_texture_is_not_made_to_fit() -> None:
    values = [
        correlation(a_texture(s), aligned(a_texture(s), a_texture(s + 50), EVERYWHERE)) for s in range(8)
    ]
    assert np.mean(values) < 0.12
    assert np.max(values) < 0.2


def test_much_farther_than_labels_are_off_is_not_followed() -> None:
    texture = a_texture(3)
    far = 12.0 * SPREAD * np.hypot(SIDE, SIDE)
    picture = carried(texture, np.array([[0.0, 0.0, far], [0.0, 0.0, 0.0]]))
    assert correlation(picture, aligned(picture, texture, EVERYWHERE)) < 0.4


def test_too_little_of_a_texture_is_left_alone() -> None:
    there = np.zeros((SIDE, SIDE), dtype=bool)
    there[:5, :5] = True
    texture = a_texture(4)
    assert aligned(a_texture(5), texture, there) is texture
