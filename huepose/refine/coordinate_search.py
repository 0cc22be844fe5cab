"""Coordinate search on the dense score: small rotations and translations along the object's axes that
increase it.

It finds what depth alone does not fix, such as the rotation of a can or a slide along a face.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.judge.kernel import SCRATCH_ROWS, TERMS, score_kernel
from huepose.judge.kernel_arrays import ModelArrays, RegionArrays, model_arrays, region_arrays
from huepose.judge.outline import NO_RIM, Rim, rim_agreement
from huepose.judge.region import Region
from huepose.judge.weights import DEFAULT_WEIGHTS, ScoreWeights
from huepose.model.types import ReferenceModel
from huepose.refine.solver import rotation_exp_into
from huepose.support.jit import jit

SHIFT_PER_RADIAN = 0.4
"""A rotation step of one radian goes with a translation step of this many diameters: both move the surface
about as far."""

RACE = 0.15
"""How far the total of a pose may lie behind the best of its competitors, per degree of the next step. Of
1000 starts on real, cluttered and piled frames, none that was farther behind won in the end."""

REPETITIONS, STRIDES = 2, 3
"""Passes over all six directions with one step size, and most steps in a row in a direction that improves."""

WORTH = 1e-4
"""Least gain in the total for which a step is taken."""


def search(
    model: ReferenceModel,
    region: Region,
    poses: Float,
    steps_deg: Sequence[float],
    samples: int,
    race: float = np.inf,
) -> tuple[Float64, Float64]:
    """Improve poses (M, 4, 4) by rotations about the object's centre and by shifts, along the object's axes,
    with the step sizes `steps_deg` one after the other; returns poses (M, 4, 4) and their totals (M,).

    race: for poses that compete with each other, RACE. A pose whose total lies behind the best by more than
    this per degree of the next step is not improved further.
    """
    on = _judged(model_arrays(model), region_arrays(region), samples, DEFAULT_WEIGHTS, NO_RIM)
    return _searched(model, poses, steps_deg, on, race)


def search_rendered_view(
    model: ReferenceModel,
    rendered: ModelArrays,
    region: RegionArrays,
    rim: Rim,
    T_cam_obj: Float,
    steps_deg: Sequence[float],
    samples: int,
    weights: ScoreWeights,
) -> Float64:
    """The same for one pose (4, 4) with the arrays of its rendered view; its outline counts as well."""
    on = _judged(rendered, region, samples, weights, rim)
    return np.asarray(_searched(model, T_cam_obj[None], steps_deg, on, np.inf)[0][0])


def _searched(
    model: ReferenceModel, poses: Float, steps_deg: Sequence[float], on: _Judged, race: float
) -> tuple[Float64, Float64]:
    out = np.array(poses, dtype=np.float64)
    totals = np.zeros(len(out))
    steps, shift = np.radians(np.asarray(steps_deg, np.float64)), model.diameter_m * SHIFT_PER_RADIAN
    _search_all(out, on, model.mesh.centre, shift, steps, race, totals)
    return out, totals


@jit
def stepped(
    T: Float64,
    axis: int,
    step: float,
    centre: Float64,
    shift_per_radian: float,
    rotation: Float64,
    out: Float64,
) -> None:
    """Write to `out` the pose `T` after a rotation by `step` about object axis 0..2 through `centre`, or a
    shift along axis 3..5."""
    out[:] = T
    if axis >= 3:
        for r in range(3):
            out[r, 3] += T[r, axis - 3] * step * shift_per_radian
        return
    rotation_exp_into(
        step if axis == 0 else 0.0, step if axis == 1 else 0.0, step if axis == 2 else 0.0, rotation
    )
    for r in range(3):
        a, b, c = T[r, 0], T[r, 1], T[r, 2]
        for k in range(3):
            out[r, k] = a * rotation[0, k] + b * rotation[1, k] + c * rotation[2, k]
        for k in range(3):
            out[r, 3] += (T[r, k] - out[r, k]) * centre[k]


Climb = Callable[[Float64, float, Any, float, Float64, float], float]
"""Moves a pose in place, by steps of one size along one axis after the other, while its value grows; returns
the value. Arguments: the pose (4, 4), its value, what it is judged on, the step size, the centre of
rotations, and the shift per radian."""


def climber(objective: Callable[[Float64, Any, float], float]) -> Climb:
    """The search loop for a compiled objective: a function of a pose, what it is judged on, and the value
    that it must exceed."""

    @jit
    def climb(
        T: Float64, best: float, on: Any, size: float, centre: Float64, shift_per_radian: float
    ) -> float:
        rotation, trial = np.empty((3, 3)), np.empty((4, 4))
        failed = np.full((6, 2), -1)  # by axis and sign: number of moves at the failure
        moves = 0
        for _ in range(REPETITIONS):
            before = moves
            for axis in range(6):
                for way in range(2):
                    if failed[axis, way] == moves:
                        continue  # Already tried from this pose.
                    for _stride in range(STRIDES):
                        stepped(T, axis, size if way else -size, centre, shift_per_radian, rotation, trial)
                        needed = best + WORTH
                        total = objective(trial, on, needed)
                        if total <= needed:
                            failed[axis, way] = moves
                            break
                        best = total
                        T[:] = trial
                        moves += 1
                        failed[axis, 1 - way] = moves  # It would lead back.
            if moves == before:
                break
        return best

    return climb


class _Judged(NamedTuple):
    """What a pose is judged on, by the dense score and by the outline of a rendered view."""

    model: ModelArrays
    region: RegionArrays
    samples: int
    weights: ScoreWeights
    rim: Rim
    scratch: Float64
    terms: Float64


def _judged(
    model: ModelArrays, region: RegionArrays, samples: int, weights: ScoreWeights, rim: Rim
) -> _Judged:
    scratch, terms = np.empty((SCRATCH_ROWS, samples)), np.empty(TERMS)
    return _Judged(model, region, samples, weights, rim, scratch, terms)


@jit
def _total(T: Float64, on: _Judged, needed: float) -> float:
    """The total of a pose; if it does not exceed `needed`, possibly only an upper bound that does not
    either."""
    edge = 0.0
    if on.rim.weight > 0.0:
        edge = on.rim.weight * rim_agreement(T, on.rim, on.region)
    return edge + score_kernel(
        T, on.model, on.region, on.samples, on.weights, on.scratch, on.terms, needed - edge
    )


_climb = climber(_total)


@jit
def _search_all(
    poses: Float64,
    on: _Judged,
    centre: Float64,
    shift_per_radian: float,
    steps: Float64,
    race: float,
    totals: Float64,
) -> None:
    for m in range(poses.shape[0]):
        totals[m] = _total(poses[m], on, -np.inf)
    for level in range(steps.shape[0]):
        least = totals.max() - race * np.degrees(steps[level]) if poses.shape[0] else 0.0
        for m in range(poses.shape[0]):
            if totals[m] >= least:
                totals[m] = _climb(poses[m], totals[m], on, steps[level], centre, shift_per_radian)
