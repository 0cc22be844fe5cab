"""Coordinate search on the pair score: the texture decides what depth leaves open, by pairs alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.judge.pair_kernel import Judged, PairPicture, Room, pair_kernel, scratch
from huepose.judge.pair_terms import DEFAULT_PAIR_WEIGHTS, PairWeights, judged_on
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.refine.coordinate_search import REPETITIONS, SHIFT_PER_RADIAN, STRIDES, WORTH, stepped
from huepose.support.jit import jit


def search_pairs(
    model: ReferenceModel,
    region: Region,
    picture: PairPicture,
    poses: Float,
    steps_deg: Sequence[float],
    pairs: int = 300,
    samples: int = 150,
    weights: PairWeights = DEFAULT_PAIR_WEIGHTS,
) -> tuple[Float64, Float64]:
    """Improve poses (M, 4, 4) by turns about the object's centre and shifts, along the object's axes, with
    steps of `steps_deg` one after the other; returns poses (M, 4, 4) and their totals (M,)."""
    out = np.array(poses, dtype=np.float64)
    totals = np.zeros(len(out))
    _search_all(
        out,
        judged_on(model, region, picture, pairs, samples, weights),
        scratch(samples),
        model.mesh.centre,
        model.diameter_m * SHIFT_PER_RADIAN,
        np.radians(np.asarray(steps_deg, dtype=np.float64)),
        totals,
    )
    return out, totals


@jit
def _search_all(
    poses: Float64,
    on: Judged,
    room: Room,
    centre: Float64,
    shift_per_radian: float,
    steps: Float64,
    totals: Float64,
) -> None:
    turn, trial = np.empty((3, 3)), np.empty((4, 4))
    failed = np.empty((6, 2), np.int64)  # By axis and way: how many moves had been made then.
    for m in range(poses.shape[0]):
        T = poses[m]
        best = pair_kernel(T, on, room, -np.inf)
        for level in range(steps.shape[0]):
            moves = 0
            failed[:] = -1
            for _ in range(REPETITIONS):
                before = moves
                for axis in range(6):
                    for way in range(2):
                        if failed[axis, way] == moves:
                            continue  # Tried already from this very pose.
                        for _stride in range(STRIDES):
                            step = steps[level] if way else -steps[level]
                            stepped(T, axis, step, centre, shift_per_radian, turn, trial)
                            needed = best + WORTH
                            total = pair_kernel(trial, on, room, needed)
                            if total <= needed:
                                failed[axis, way] = moves
                                break
                            best = total
                            T[:] = trial
                            moves += 1
                            failed[axis, 1 - way] = moves  # It would only lead back.
                if moves == before:
                    break
        totals[m] = best
