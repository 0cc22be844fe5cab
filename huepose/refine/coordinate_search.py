"""Coordinate search on the dense score: what depth alone cannot fix (a can's turn, a slide along a face) is
found by small turns and shifts that the texture likes better."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.geometry.kernels import rotation_exp_into
from huepose.judge.arrays import ModelArrays, RegionArrays, model_arrays, region_arrays
from huepose.judge.kernel import SCRATCH_ROWS, TERMS, score_kernel
from huepose.judge.outline import NO_RIM, Rim, rim_agreement
from huepose.judge.region import Region
from huepose.judge.terms import DEFAULT_WEIGHTS, ScoreWeights, weight_array
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit

SHIFT_PER_RADIAN = 0.4
"""A step of one radian goes with a shift of 0.4 diameters: both move the surface about as far."""

RACE = 0.15
"""Total a degree of the next step by which a pose that competes with others may lie behind the best of them:
of 1000 starts on real, cluttered and piled frames none that was farther behind won in the end."""

REPETITIONS = 2
STRIDES = 3
WORTH = 1e-4


def search(
    model: ReferenceModel,
    region: Region,
    poses: Float,
    steps_deg: Sequence[float],
    samples: int,
    weights: ScoreWeights = DEFAULT_WEIGHTS,
    race: float = np.inf,
) -> tuple[Float64, Float64]:
    """Improve poses (M, 4, 4) by turns about the object's centre and shifts, along the object's axes, with
    steps of `steps_deg` one after the other; returns poses (M, 4, 4) and their totals (M,).

    Where the poses are rivals for one answer, `race` (RACE) leaves those as they are whose total lies behind
    the best by more than that a degree of the next step.
    """
    out = np.array(poses, dtype=np.float64)
    totals = np.zeros(len(out))
    _search_all(
        out,
        model_arrays(model),
        region_arrays(region),
        model.mesh.centre,
        model.diameter_m * SHIFT_PER_RADIAN,
        np.radians(np.asarray(steps_deg, dtype=np.float64)),
        samples,
        weight_array(weights),
        NO_RIM,
        race,
        totals,
    )
    return out, totals


def search_rendered_view(
    model: ReferenceModel,
    drawn: ModelArrays,
    region: RegionArrays,
    rim: Rim,
    T_cam_obj: Float,
    steps_deg: Sequence[float],
    samples: int,
    weights: ScoreWeights,
) -> tuple[Float64, float]:
    """The same for one pose (4, 4) with the arrays of its rendered view, its outline counting as well."""
    out, totals = np.array(T_cam_obj, dtype=np.float64)[None], np.zeros(1)
    _search_all(
        out,
        drawn,
        region,
        model.mesh.centre,
        model.diameter_m * SHIFT_PER_RADIAN,
        np.radians(np.asarray(steps_deg, dtype=np.float64)),
        samples,
        weight_array(weights),
        rim,
        np.inf,
        totals,
    )
    return out[0], float(totals[0])


@jit
def _search_all(
    poses: Float64,
    model: ModelArrays,
    region: RegionArrays,
    centre: Float64,
    shift_per_radian: float,
    steps: Float64,
    samples: int,
    weights: Float64,
    rim: Rim,
    race: float,
    totals: Float64,
) -> None:
    scratch, terms = np.empty((SCRATCH_ROWS, samples)), np.empty(TERMS)
    turn, trial = np.empty((3, 3)), np.empty((4, 4))
    failed = np.empty((6, 2), np.int64)  # by axis and way: how many moves had been made then
    for m in range(poses.shape[0]):
        totals[m] = score_kernel(poses[m], model, region, samples, weights, scratch, terms, -np.inf)
        if rim.weight > 0.0:
            totals[m] += rim.weight * rim_agreement(poses[m], rim, region)
    for level in range(steps.shape[0]):
        least = totals.max() - race * np.degrees(steps[level]) if poses.shape[0] else 0.0
        for m in range(poses.shape[0]):
            if totals[m] < least:
                continue
            T, best = poses[m], totals[m]
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
                            edge = 0.0
                            if rim.weight > 0.0:
                                edge = rim.weight * rim_agreement(trial, rim, region)
                            total = edge + score_kernel(
                                trial, model, region, samples, weights, scratch, terms, needed - edge
                            )
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


@jit
def stepped(
    T: Float64,
    axis: int,
    step: float,
    centre: Float64,
    shift_per_radian: float,
    turn: Float64,
    out: Float64,
) -> None:
    """Pose `T` after a turn by `step` about object axis 0..2 through `centre`, or a shift along axis 3..5."""
    out[:] = T
    if axis >= 3:
        for r in range(3):
            out[r, 3] += T[r, axis - 3] * step * shift_per_radian
        return
    rotation_exp_into(
        step if axis == 0 else 0.0, step if axis == 1 else 0.0, step if axis == 2 else 0.0, turn
    )
    for r in range(3):
        a, b, c = T[r, 0], T[r, 1], T[r, 2]
        for k in range(3):
            out[r, k] = a * turn[0, k] + b * turn[1, k] + c * turn[2, k]
        for k in range(3):
            out[r, 3] += (T[r, k] - out[r, k]) * centre[k]
