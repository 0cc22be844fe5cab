"""Array types by meaning, and what draws them at random. Shapes are in the docstrings; dtypes are here."""

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
