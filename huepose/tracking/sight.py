"""What is seen of an object at a pose: the judge's terms, its hues, and whether its surface ends where it
should."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.judge.continuation import continuation_many
from huepose.judge.hue import hue_log_ratio, hue_samples
from huepose.judge.open_region import OpenRegion
from huepose.judge.surface import PreparedSurface
from huepose.judge.terms import NOTHING, Terms, score_arrays

SAMPLES = 400
OUTLINE_SAMPLES = 300
LIGHT_SPREAD, UNKNOWN_LIGHT_SPREAD = 4.0, 15.0
"""Opponent units by which the hue of a light is known: of the object's own light a moment ago, and of any."""


@dataclass(frozen=True)
class Sight:
    """terms of the judge; hue: how much likelier the hues are the object's than anything's, mean log ratio;
    goes_on 0..1: share of the rim where the surface that is seen goes on beyond the object's."""

    terms: Terms
    hue: float
    goes_on: float

    @property
    def total(self) -> float:
        """The judge's total, by which poses of one frame are compared."""
        return self.terms.total


UNSEEN = Sight(NOTHING, 0.0, 0.0)
"""Of a pose outside of the image."""


def look(surface: PreparedSurface, region: OpenRegion, T_cam_obj: Float64) -> Sight:
    """Look at a pose (4, 4) closely (some 0.2 ms)."""
    model, arrays = surface.arrays, region.arrays
    T = np.ascontiguousarray(T_cam_obj, np.float64)
    terms = Terms(*(float(x) for x in score_arrays(model, arrays, T[None], SAMPLES)[0]))
    if terms.seen <= 0.0:
        return Sight(terms, 0.0, 0.0)
    hues = hue_samples(
        model, arrays.depth, arrays.colors, arrays.saturated, region.camera, arrays.tolerance, T
    )
    light = arrays.light[1:] if arrays.lit else np.zeros(2)
    hue = hue_log_ratio(hues, light, LIGHT_SPREAD if arrays.lit else UNKNOWN_LIGHT_SPREAD)
    goes_on = continuation_many(
        model, arrays.depth, arrays.depth > 0, region.camera, T[None], OUTLINE_SAMPLES
    )[0]
    return Sight(terms, hue, float(goes_on))


def totals(
    surface: PreparedSurface,
    region: OpenRegion,
    poses: Float64,
    samples: int,
    tolerance_m: float | None = None,
) -> Float64:
    """Totals (K,) of poses (K, 4, 4) by few samples and the coarser colours, whose basins are wide."""
    arrays = region.blunt()
    if tolerance_m is not None:
        arrays = arrays._replace(tolerance=tolerance_m)
    return np.asarray(score_arrays(surface.arrays, arrays, poses, samples)[:, 0])
