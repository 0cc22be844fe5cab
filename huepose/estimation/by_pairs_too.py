"""The different poses in the end are put in order by colour pairs as well as by the dense score.

The dense score smooths the print over a millimetre or more and reads it everywhere; pairs read it sharply,
on both sides of its edges only. So near-ties that one of them cannot tell, as of a can turned about its axis,
the other one often can. Only the order may change: what else an answer says stays that of the dense score.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.model.types import ReferenceModel
from huepose.verification.pairs import DEFAULT_PAIR_WEIGHTS, pair_picture, pair_score_many
from huepose.verification.region import Region

WEIGHT = 0.2
"""Of the pairs' colours against the dense score."""

PAIRS, SAMPLES = 1500, 600


def ordered_by_pairs_too(
    model: ReferenceModel, region: Region, poses: Float64, totals: Float64, weight: float = WEIGHT
) -> tuple[Float64, Float64]:
    """Poses (K, 4, 4) and dense totals (K,), best first, as they were unless pairs prefer another one.

    The preferred pose keeps its total, and the others' say how far they are behind it with pairs counted.
    """
    if len(poses) < 2:
        return poses, totals
    both = totals + weight * pair_colors(model, region, poses)
    order = np.argsort(-both, kind="stable")
    if order[0] == 0:
        return poses, totals
    best = order[0]
    return poses[order], totals[best] - (both[best] - both[order])


def pair_colors(model: ReferenceModel, region: Region, poses: Float64) -> Float64:
    """How well the colours of the model's pairs agree at poses (K, 4, 4), 0 without pairs: (K,)."""
    picture = pair_picture(model, region.crop, region.median_depth_m)
    terms = pair_score_many(model, region, picture, poses, PAIRS, SAMPLES)
    weights = DEFAULT_PAIR_WEIGHTS
    return np.asarray(weights.color * terms[:, 2] + weights.contrast * terms[:, 3])
