"""Weights of the terms of a pose's score."""

from __future__ import annotations

from typing import NamedTuple


class ScoreWeights(NamedTuple):
    """Weights of the terms in the total, as the kernels read them.

    lightness: relative weight of lightness against the other two channels.
    coarse: relative weight of the 3.5 mm scale against the 1 mm scale.
    outside: weight of depth that fits outside the mask.
    color_floor: opponent units, keeps the correlation of plain surfaces low.
    """

    depth_fit: float = 0.9
    coverage: float = 0.7
    violation: float = 1.0
    color: float = 1.0
    occluded: float = 0.05
    box: float = 0.5
    lightness: float = 0.8
    coarse: float = 0.5
    outside: float = 0.6
    color_floor: float = 1.5


DEFAULT_WEIGHTS = ScoreWeights()
