"""Is the object here at all?

Whether a *pose* is right asks for texture that tells it from its turns; a plain mug has none, and is there
all the same. What speaks for an object being there is a shape that explains the depth, without a surface that
goes on where the object ends, and a picture that looks like the object in this pose. All of it says the less
the fewer pixels it is read from: in a speck of ten anything fits. A refined pose is asked one thing more: a
network compares picture and model pixel by pixel. A rough one is off by too much for that, and has weights of
its own.

The weighted sum of these is a logit; the weights are fitted on drawn scenes (`believe.logistic`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from huepose.believe.logistic import Logistic, belief
from huepose.geometry.arrays import Float64
from huepose.judge.color_correlation import PLAIN

ENOUGH_PIXELS, FEWEST_PIXELS = 400, 4
"""More pixels say no more: their errors are not independent."""

MOST_ALIKE, MOST_VERIFIED = 0.3, 4.6
"""Nine of ten true poses have less: of likeness in real frames, of verification in drawn ones."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What is seen where a pose says that an object is. fit 0..1, texture -1..1, contrast: terms of the dense
    score; rim 0..1: where the surface goes on beside it; goes_on 0..1: share of the outline beyond which
    surface and colour go on; likeness -1..1: of codes of the picture and of the model in this pose; verified:
    log-odds that a network gives to both showing the same, None for a rough pose; pixels: of the picture that
    agree in depth."""

    fit: float
    texture: float
    contrast: float
    rim: float
    goes_on: float
    likeness: float
    verified: float | None
    pixels: int


def _weights(seen: Sight) -> Logistic:
    """The fitted weights of its `features`: those of refined poses, or of rough ones."""
    return belief("place" if seen.verified is None else "presence")


def features(seen: Sight) -> dict[str, float]:
    """What the log-odds are made of: depth that fits; color, how much less texture there is than the object
    would show, which says nothing of a plain one; a rim where the surface does not go on; an outline that
    ends; likeness; pixels, by their logarithm; and of a refined pose what the verifying network says."""
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
"""Of poses that are right: medians on the set that the weights are fitted to."""

DOUBTS = {
    "fit": "the depth fits its surface too little",
    "color": "its texture is not seen there",
    "free_rim": "a surface goes on where the object ends",
    "ends": "surface and colour go on beyond its outline",
    "likeness": "the picture looks unlike it",
    "verified": "the picture does not show it in this pose",
    "pixels": "too few pixels show it",
}


def greatest_doubt(seen: Sight) -> str:
    """What speaks most against the object, in words: the feature that costs the most log-odds beside those
    of poses that are right."""
    fit, values = _weights(seen), features(seen)
    costs = {name: factor * (USUAL[name] - values[name]) for name, factor in fit.factors.items()}
    return DOUBTS[max(costs, key=lambda name: costs[name])]


def logits_of(sights: Sequence[Sight], fit: Logistic | None = None) -> Float64:
    """Logit (N,) of each sight, by the shipped weights or by `fit`."""
    return np.array([(fit or _weights(s)).log_odds(features(s)) for s in sights])
