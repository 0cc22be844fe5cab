"""Matrix products of arrays of a model and of an image: codes of views, descriptors of keypoints."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Float32

_NOTHING = np.empty(0, np.float32)
"""In place of the matrix that OpenCV would add to a product."""


def product(table: Float32, columns: Float32) -> Float32:
    """The matrix product (N, C) of a table (N, P) and columns (P, C)."""
    if columns.flags.f_contiguous:  # OpenCV transposes it, which is faster than a transposed copy
        found = cv2.gemm(table, columns.T, 1.0, _NOTHING, 0.0, flags=cv2.GEMM_2_T)
    else:
        found = cv2.gemm(table, np.ascontiguousarray(columns), 1.0, _NOTHING, 0.0)
    return np.asarray(found, np.float32)
