"""Distances of rotations."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float64


def angles_to(rotations: Float, reference: Float) -> Float64:
    """Geodesic distances (N,) in radians of rotations (N, 3, 3) to one (3, 3)."""
    trace = np.einsum("nij,ij->n", np.asarray(rotations, np.float64), np.asarray(reference, np.float64))
    return np.asarray(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
