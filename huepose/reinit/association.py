"""Assign estimates to tracked instances: optimal assignment on pose distance, gated by covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.uncertainty import grown
from huepose.reinit.types import ObjectSlot, Prior

GATE_SIGMAS = 3.0
"""An estimate within so many standard deviations of where an instance is expected may be that instance."""

GATE_DIAMETERS = 0.5
"""Gate in diameters, whatever the covariance: an estimate nearer than this can be the instance, one at four
times this distance cannot."""

TURN_SHARE = 0.1
"""Weight of rotation in the pose distance, for instances at equal distance: half a turn counts as a third of
a diameter."""


def displacement_m(T_a: Float64, T_b: Float64, slot: ObjectSlot) -> float:
    """Approximate surface distance of two poses T_cam_obj (4, 4), metres, the least over the object's
    symmetries."""
    turns = slot.equivalents or (np.eye(4),)
    return min(_displacement(T_a, T_b @ turn, slot.diameter_m) for turn in turns)


def _displacement(T_a: Float64, T_b: Float64, diameter_m: float) -> float:
    shift = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3]))
    return shift + 0.25 * diameter_m * se3.rotation_angle(T_a, T_b)


def assign(
    estimates: Sequence[Float64], priors: Sequence[Prior], stamp_ns: int, slot: ObjectSlot
) -> list[int | None]:
    """For each estimated pose the index of its instance, or None.

    Every instance is predicted to `stamp_ns`. Of all assignments within the gates, those with most pairs are
    taken, and of these the one with the least sum of distances.
    """
    # Every worker imports this room for its types; this one function needs a quarter of a second more, or
    # seconds on a busy computer that reads it from its disk: see `warm_up`.
    from scipy.optimize import linear_sum_assignment

    out: list[int | None] = [None] * len(estimates)
    if not estimates or not priors:
        return out
    cost = np.empty((len(estimates), len(priors)))
    for j, prior in enumerate(priors):
        expected, gate = prior.predicted(stamp_ns), _gate_m(prior, stamp_ns, slot)
        for i, T in enumerate(estimates):
            shift = float(np.linalg.norm(T[:3, 3] - expected[:3, 3]))
            turn = min(se3.rotation_angle(T @ turn, expected) for turn in slot.equivalents or (np.eye(4),))
            outside = shift > gate
            cost[i, j] = 1e3 if outside else shift + TURN_SHARE * slot.diameter_m * turn
    for i, j in zip(*linear_sum_assignment(cost), strict=True):
        if cost[i, j] < 1e3:
            out[i] = int(j)
    return out


def _gate_m(prior: Prior, stamp_ns: int, slot: ObjectSlot) -> float:
    least, most = GATE_DIAMETERS * slot.diameter_m, 2.0 * slot.diameter_m
    if prior.covariance is None:
        return most
    covariance = grown(prior.covariance, abs(stamp_ns - prior.stamp_ns) * 1e-9)
    sigma = float(np.sqrt(max(np.linalg.eigvalsh(covariance[:3, :3])[-1], 0.0)))
    return min(max(least, GATE_SIGMAS * sigma), most)
