"""A grid about the object that knows the nearest surfel of every cell: correspondence by one lookup."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float
from huepose.model.types import DistanceGrid

MARGIN_M = 0.03
_SMALLEST_STEP_M = 0.0015
_STEPS_PER_DIAMETER = 70.0


def build_grid(points: Float, diameter_m: float) -> DistanceGrid:
    """Grid over surfel `points` (N, 3), N < 32768, reaching 3 cm beyond them."""
    from scipy.spatial import cKDTree

    step = max(diameter_m / _STEPS_PER_DIAMETER, _SMALLEST_STEP_M)
    low = points.min(0).astype(np.float64) - MARGIN_M
    shape = np.ceil((points.max(0).astype(np.float64) + MARGIN_M - low) / step).astype(int) + 1
    axes = [low[k] + step * np.arange(shape[k]) for k in range(3)]
    tree = cKDTree(points)
    nearest = np.empty(shape, np.int16)
    for i, x in enumerate(axes[0]):  # a slice at a time: half a gigabyte less
        y, z = np.meshgrid(axes[1], axes[2], indexing="ij")
        nearest[i] = tree.query(np.stack([np.full_like(y, x), y, z], -1))[1]
    return DistanceGrid(low, float(step), nearest)
