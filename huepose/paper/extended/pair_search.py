"""Coordinate search on the pair score: pairs determine what depth leaves open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.judge.pairs import PairImage
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.paper.extended.pair_score import Judged, PairScratch, judged_on, pair_kernel, scratch
from huepose.refine.coordinate_search import SHIFT_PER_RADIAN, climber
from huepose.support.jit import jit


def search_pairs(
    model: ReferenceModel,
    region: Region,
    picture: PairImage,
    poses: Float,
    steps_deg: Sequence[float],
    pairs: int = 300,
    samples: int = 150,
) -> tuple[Float64, Float64]:
    """Improve poses (M, 4, 4) by rotations about the object's centre and by shifts, along the object's axes,
    with steps of `steps_deg` one after the other; returns poses (M, 4, 4) and their totals (M,)."""
    out = np.array(poses, dtype=np.float64)
    totals = np.zeros(len(out))
    _search_all(
        out,
        judged_on(model, region, picture, pairs, samples),
        scratch(samples),
        model.mesh.centre,
        model.diameter_m * SHIFT_PER_RADIAN,
        np.radians(np.asarray(steps_deg, dtype=np.float64)),
        totals,
    )
    return out, totals


class _On(NamedTuple):
    judged: Judged
    work: PairScratch


@jit
def _total(T: Float64, on: _On, needed: float) -> float:
    return pair_kernel(T, on.judged, on.work, needed)


_climb = climber(_total)


@jit
def _search_all(
    poses: Float64,
    judged: Judged,
    work: PairScratch,
    centre: Float64,
    shift_per_radian: float,
    steps: Float64,
    totals: Float64,
) -> None:
    on = _On(judged, work)
    for m in range(poses.shape[0]):
        totals[m] = _total(poses[m], on, -np.inf)
        for level in range(steps.shape[0]):
            totals[m] = _climb(poses[m], totals[m], on, steps[level], centre, shift_per_radian)
