"""Matrix products of what a model stores and what a picture shows: codes of views, descriptors of
keypoints."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Float32

_NOTHING = np.empty(0, np.float32)
"""In place of what OpenCV would add to a product."""


def product(table: Float32, columns: Float32) -> Float32:
    """The matrix product (N, C) of a table (N, P) and columns (P, C)."""
    if columns.flags.f_contiguous:  # OpenCV turns it, which is faster than to copy it turned
        found = cv2.gemm(table, columns.T, 1.0, _NOTHING, 0.0, flags=cv2.GEMM_2_T)
    else:
        found = cv2.gemm(table, np.ascontiguousarray(columns), 1.0, _NOTHING, 0.0)
    return np.asarray(found, np.float32)
