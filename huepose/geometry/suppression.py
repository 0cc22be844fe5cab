"""Greedy non-maximum suppression: of poses close to each other only the best is kept."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64, Int64
from huepose.support.jit import jit

ORIGIN = np.zeros(3)


def first_different(
    poses: Float64, turn_rad: float, count: int, shift_m: float = np.inf, centre: Float64 = ORIGIN
) -> Int64:
    """Indices (K,) of at most `count` of the poses (N, 4, 4), sorted best first, that differ from all
    chosen before by `turn_rad` in rotation, or by `shift_m` in the position of the object's point `centre`
    (3,). By default only the rotation counts."""
    least_trace = 1.0 + 2.0 * float(np.cos(turn_rad))
    most = min(count, len(poses))
    return _different(poses, np.asarray(centre, np.float64), least_trace, float(shift_m), most)


@jit
def _different(poses: Float64, centre: Float64, least_trace: float, min_shift: float, count: int) -> Int64:
    chosen = np.empty(count, np.int64)
    places = np.empty((count, 3))
    n = 0
    here = np.empty(3)
    for i in range(poses.shape[0]):
        if n == count:
            break
        T = poses[i]
        for r in range(3):
            here[r] = T[r, 0] * centre[0] + T[r, 1] * centre[1] + T[r, 2] * centre[2] + T[r, 3]
        is_new = True
        for k in range(n):
            S = poses[chosen[k]]
            trace, shift2 = 0.0, 0.0
            for r in range(3):
                shift2 += (here[r] - places[k, r]) ** 2
                for c in range(3):
                    trace += T[r, c] * S[r, c]
            if trace >= least_trace and shift2 <= min_shift * min_shift:
                is_new = False
                break
        if is_new:
            chosen[n] = i
            places[n] = here
            n += 1
    return chosen[:n]
