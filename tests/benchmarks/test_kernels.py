"""Calls and bytes of kernels are counted; the time on a GPU is bounded."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.kernels import Use, on_gpu_s, rows, watched
from huepose.propose import views


def test_calls_and_bytes_of_a_kernel_are_counted_and_the_kernel_is_restored() -> None:
    mask, kernel = np.ones((4, 6), bool), views._centroid
    with watched() as uses:
        for _ in range(3):
            middle = views._centroid(mask)
    np.testing.assert_allclose(middle, [2.5, 1.5])
    use = uses["huepose.propose.views._centroid"]
    assert (use.calls, use.handed_bytes) == (3, 3 * (mask.nbytes + middle.nbytes))
    assert use.cpu_s > 0.0
    assert views._centroid is kernel
    assert [row["calls"] for row in rows(uses, 2, 1e9)] == [1.5]


def test_the_gpu_estimate_includes_calls_operations_and_bytes() -> None:
    assert on_gpu_s(Use(calls=2), 1e9, 1e12, 1e10) == pytest.approx(60e-6)
    assert on_gpu_s(Use(cpu_s=1.0), 1e9, 1e12, 1e10) == pytest.approx(5e-3)
    assert on_gpu_s(Use(handed_bytes=6_000_000), 1e9, 1e12, 1e10) == pytest.approx(1e-3)
