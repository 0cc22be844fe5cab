"""An image between its pixels."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry.bilinear import bilinear


def test_a_plane_is_interpolated_exactly_and_the_border_continues_outside() -> None:
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:7, :9]
    image = np.stack([2.0 * columns + rows, 5.0 * rows - columns], 2)
    u, v = rng.uniform(-3, 12, 500), rng.uniform(-3, 10, 500)
    x, y = u.clip(0, 8), v.clip(0, 6)
    assert bilinear(image, u, v) == pytest.approx(np.stack([2.0 * x + y, 5.0 * y - x], 1))


def test_an_image_of_one_pixel_is_the_same_everywhere() -> None:
    image = np.full((1, 1, 3), (7, 8, 9), np.uint8)
    assert np.array_equal(
        bilinear(image, np.array([0.0, -0.4, 3.0]), np.array([0.0, 0.3, -2.0])), image[[0] * 3, 0]
    )
