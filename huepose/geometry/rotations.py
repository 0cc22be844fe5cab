"""Mean rotations that do not depend on the signs of quaternions."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.geometry.se3 import quaternion_from_rotation, rotation_from_quaternion


def mean_rotation(rotations: Float, weights: Float | None = None) -> Float64:
    """Weighted chordal mean (3, 3) of rotations (N, 3, 3).

    The eigenvector of the largest eigenvalue of sum w q q^T (Markley et al. 2007, doi 10.2514/1.28949).
    Raises ValueError without rotations.
    """
    if not len(rotations):
        raise ValueError("the mean of no rotations is not defined")
    w = np.ones(len(rotations)) if weights is None else np.asarray(weights, np.float64)
    q = np.stack([quaternion_from_rotation(R) for R in rotations])
    _, vectors = np.linalg.eigh((q * w[:, None]).T @ q)
    return rotation_from_quaternion(vectors[:, -1])


def angles_to(rotations: Float, reference: Float) -> Float64:
    """Geodesic distances (N,) in radians of rotations (N, 3, 3) to one (3, 3)."""
    trace = np.einsum("nij,ij->n", np.asarray(rotations, np.float64), np.asarray(reference, np.float64))
    return np.asarray(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
