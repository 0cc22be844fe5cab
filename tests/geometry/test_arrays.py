"""The median is that of NumPy, for odd and even numbers of readings."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry.arrays import median


@pytest.mark.parametrize("count", [1, 2, 3, 10, 1001, 4000])
def test_the_median_is_that_of_numpy(count: int) -> None:
    readings = np.random.default_rng(count).normal(0.8, 0.1, count).astype(np.float32)
    assert median(readings) == float(np.median(readings))
