"""One answer, one pose: of poses that lie close to each other the best one stays."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit

FINAL_TURN_RAD, FINAL_SHIFT = 0.2, 0.05
"""Poses closer than this (shift in diameters) are one answer."""


def different_poses(
    model: ReferenceModel,
    poses: Float64,
    totals: Float64,
    count: int,
    turn_rad: float = 0.15,
    shift: float = 0.03,
) -> np.ndarray:
    """Indices (K,) of at most `count` poses (N, 4, 4), best total first, that differ from all better ones by
    `turn_rad` or by `shift` diameters at the object's centre."""
    order = np.argsort(-totals, kind="stable")
    first = first_different(poses[order], model.mesh.centre, turn_rad, shift * model.diameter_m, count)
    return np.asarray(order[first])


def first_different(
    poses: Float64, centre: Float64, turn_rad: float, shift_m: float, count: int
) -> np.ndarray:
    """Indices (K,) of at most `count` poses (N, 4, 4), best first, that differ from all better ones by
    `turn_rad` or by `shift_m` at `centre` (3,) of the object."""
    least_trace = 1.0 + 2.0 * float(np.cos(turn_rad))
    return np.asarray(_different(poses, np.asarray(centre, np.float64), least_trace, shift_m, count))


@jit
def _different(
    poses: Float64, centre: Float64, least_trace: float, min_shift: float, count: int
) -> np.ndarray:
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
