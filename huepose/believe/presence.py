"""Is the object there at all?

Whether a *pose* is right depends on texture that distinguishes its orientations. A plain mug has none, and
may be there all the same. Evidence for an object is a shape that explains the depth, no surface that goes on
where the object ends, and an image that looks like the object in this pose. All of it counts less the fewer
pixels there are: to ten pixels anything fits. For a refined pose there is one more term: a network compares
image and model pixel by pixel. A rough pose is too inaccurate for that, and has weights of its own.

The weighted sum of these is a logit; the weights are fitted on rendered scenes (`believe.logistic`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from huepose.believe.logistic import Logistic, belief
from huepose.geometry.arrays import Float64
from huepose.judge.color_correlation import PLAIN

ENOUGH_PIXELS, FEWEST_PIXELS = 400, 4
"""More pixels count no more: their errors are not independent."""

MOST_ALIKE, MOST_VERIFIED = 0.3, 4.6
"""Nine of ten true poses have less: likeness in real frames, verification in rendered ones."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What the image shows where a pose places an object. fit 0..1, texture -1..1, contrast: terms of the
    dense score; rim 0..1: where the surface goes on beside it; goes_on 0..1: share of the outline beyond
    which surface and colour go on; likeness -1..1: of the view codes of the image and of the model in this
    pose; verified: log-odds of a network that both show the same, None for a rough pose; pixels: number of
    pixels that agree in depth."""

    fit: float
    texture: float
    contrast: float
    rim: float
    goes_on: float
    likeness: float
    verified: float | None
    pixels: int


def _weights(seen: Sight) -> Logistic:
    """The fitted weights of the `features`: those for refined poses, or for rough ones."""
    return belief("place" if seen.verified is None else "presence")


def features(seen: Sight) -> dict[str, float]:
    """The terms of the log-odds: fit to the depth; color, the texture that is missing, which is no evidence
    for a plain object; a rim where the surface does not go on; an outline where it ends; likeness; pixels, by
    their logarithm; and, for a refined pose, the verification."""
    known = {
        "fit": seen.fit,
        "color": -max(seen.contrast / (seen.contrast + PLAIN) - seen.texture, 0.0),
        "free_rim": 1.0 - seen.rim,
        "ends": -seen.goes_on,
        "likeness": seen.likeness,
        "pixels": log(min(max(seen.pixels, FEWEST_PIXELS), ENOUGH_PIXELS)),
    }
    return known if seen.verified is None else {**known, "verified": seen.verified}


USUAL = {
    "fit": 0.43,
    "color": -0.23,
    "free_rim": 1.0,
    "ends": 0.0,
    "likeness": 0.28,
    "verified": 4.36,
    "pixels": 5.99,
}
"""Values for right poses: medians on the set that the weights are fitted to."""

DOUBTS = {
    "fit": "the depth fits its surface too little",
    "color": "its texture is not seen there",
    "free_rim": "a surface goes on where the object ends",
    "ends": "surface and colour go on beyond its outline",
    "likeness": "the image looks unlike it",
    "verified": "the image does not show it in this pose",
    "pixels": "too few pixels show it",
}


def greatest_doubt(seen: Sight) -> str:
    """The strongest evidence against the object, in words: the feature that costs the most log-odds compared
    with right poses."""
    fit, values = _weights(seen), features(seen)
    costs = {name: factor * (USUAL[name] - values[name]) for name, factor in fit.factors.items()}
    return DOUBTS[max(costs, key=lambda name: costs[name])]


def logits_of(sights: Sequence[Sight], fit: Logistic | None = None) -> Float64:
    """Logit (N,) of each sight, by the shipped weights or by `fit`."""
    return np.array([(fit or _weights(s)).log_odds(features(s)) for s in sights])
