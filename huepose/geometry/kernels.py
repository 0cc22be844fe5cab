"""Rotations inside compiled loops: what `se3` does for arrays, for scalars, without allocation."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.support.jit import jit


@jit
def rotation_exp_into(x: float, y: float, z: float, R: Float64) -> None:
    """Write the rotation matrix (3, 3) of the rotation vector (x, y, z) in radians into `R`."""
    angle2 = x * x + y * y + z * z
    angle = np.sqrt(angle2)
    if angle < 1e-6:
        s, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        s, c = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    R[1, 0], R[1, 1], R[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    R[2, 0], R[2, 1], R[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)


@jit
def solve_symmetric(A: Float64, b: Float64, x: Float64) -> bool:
    """Solve the symmetric positive definite system `A x = b` (n, n) by Cholesky; only the lower triangle of
    `A` is read, and it is overwritten by its factor. False when `A` is not positive definite."""
    n = A.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i == j:
                if total <= 0.0:
                    return False
                A[i, i] = np.sqrt(total)
            else:
                A[i, j] = total / A[j, j]
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= A[i, k] * x[k]
        x[i] = total / A[i, i]
    for i in range(n - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, n):
            total -= A[k, i] * x[k]
        x[i] = total / A[i, i]
    return True
