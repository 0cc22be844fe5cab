"""Printed matter: sizes, determinism, text that fits its box."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.scenes import textures

ARTS = {
    "front": textures.front("TITLE", "subtitle", "NEW"),
    "facts": textures.facts,
    "blocks": textures.blocks("WORD"),
    "lid": textures.lid("PULL"),
    "wrapper": textures.wrapper("TITLE", "subtitle", "NEW"),
    **{f"sticker{k}": textures.sticker("WORD 7", k) for k in range(4)},
}


@pytest.mark.parametrize("name", ARTS)
@pytest.mark.parametrize("size", [(240, 320), (300, 90), (40, 37)])
def test_art_has_the_given_size_is_deterministic_and_has_contrast(name: str, size: tuple[int, int]) -> None:
    p = textures.palette(0.3, np.random.default_rng(1))
    one = ARTS[name](np.random.default_rng(5), *size, p)
    two = ARTS[name](np.random.default_rng(5), *size, p)
    assert one.shape == (*size, 3)
    assert one.dtype == np.uint8
    assert np.array_equal(one, two)
    assert one.std() > 15


def test_written_text_stays_in_its_box() -> None:
    image = np.zeros((200, 400, 3), np.uint8)
    textures.write(image, "Typography", (0.25, 0.25, 0.5, 0.5), (255, 255, 255))
    rows, columns = np.nonzero(image.max(-1))
    assert rows.min() >= 48
    assert rows.max() < 152
    assert columns.min() >= 97
    assert columns.max() < 303
    assert np.ptp(columns) > 180


def test_clouds_span_their_range() -> None:
    noise = textures.clouds(np.random.default_rng(0), 120, 160, 30)
    assert noise.shape == (120, 160)
    assert noise.min() == 0
    assert noise.max() == 1
    assert 0.35 < noise.mean() < 0.65


def test_mixed_interpolates_between_two_colours() -> None:
    share = np.array([[0.0, 0.5, 1.0]], np.float32)
    assert textures.mixed((0, 10, 200), (100, 30, 0), share)[0].tolist() == [
        [0, 10, 200],
        [50, 20, 100],
        [100, 30, 0],
    ]
