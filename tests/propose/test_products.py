"""A product of matrices is the sum over what they share."""

import numpy as np
import pytest

from huepose.propose.products import product


@pytest.mark.parametrize("shape", [(3888, 52, 90), (504, 1024, 1), (7, 128, 33), (1, 1, 1)])
def test_a_product_is_the_sum_over_the_cells(shape: tuple[int, int, int]) -> None:
    rows, cells, columns = shape
    rng = np.random.default_rng(0)
    table = rng.random((rows, cells), np.float32)
    other = rng.random((columns, cells), np.float32)
    table.flags.writeable = False  # as where it is mapped
    right = table.astype(np.float64) @ other.T
    np.testing.assert_allclose(product(table, other.T), right, rtol=1e-5)
    np.testing.assert_allclose(product(table, np.ascontiguousarray(other.T)), right, rtol=1e-5)
