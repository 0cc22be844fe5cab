"""Is the object here at all, whichever way round it is?

Whether a pose is right asks for texture that tells it from its turns; a plain mug has none, and is there all
the same. What speaks for an object being there is a shape that explains the depth, without a surface that
goes on where the object ends, and colours that are the object's, up to the one light that all of the frame
has. How much a colour says depends on how common it is: grey is everywhere, a strong red is not. All of it
says the less the fewer pixels it is read from: in a speck of ten anything fits.

The weighted sum of these is a logit; the weights are fitted on drawn scenes (`believe.fits`). (The light:
what probable places of the *other* objects say about it, as log colours are only shifted by it, after von
Kries.)"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import log

import numpy as np

from huepose.believe.fits import fitted
from huepose.believe.logistic import Logistic, probabilities
from huepose.geometry.arrays import Float64
from huepose.judge.color_correlation import PLAIN
from huepose.judge.hue import LEAST_HUES, hue_log_ratio

LIGHT_SPREAD, LIGHT_NOISE, LIGHT_REACH = 15.0, 8.0, 25.0
"""Of the hue of lights; of a place's mean hue under it; places farther off than this say little about it."""


ENOUGH_PIXELS, FEWEST_PIXELS = 400, 4
"""More pixels say no more: their errors are not independent."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What is seen where a pose says that an object is. fit 0..1, texture -1..1, contrast: terms of the dense
    score; rim 0..1: where the surface goes on beside it; goes_on 0..1: share of the outline beyond which
    surface and colour go on; pixels: of the picture that agree in depth; hues (N, 5): of samples that fit the
    depth, weight, the object's two colour opponents, and the picture's."""

    fit: float
    texture: float
    contrast: float
    rim: float
    goes_on: float
    pixels: int
    hues: Float64

    @property
    def shift(self) -> Float64:
        """Mean difference (2,) of the picture's hue from the object's; nan where hardly anything is seen."""
        if len(self.hues) < LEAST_HUES:
            return np.full(2, np.nan)
        return np.asarray(np.average(self.hues[:, 3:] - self.hues[:, 1:3], axis=0, weights=self.hues[:, 0]))


@cache
def presence_fit() -> Logistic:
    """The fitted weights of `features`."""
    return Logistic(**fitted("presence"))


def features(seen: Sight, hue: float = 0.0) -> dict[str, float]:
    """What the log-odds are made of: depth that fits; color, how much less texture there is than the object
    would show, which says nothing of a plain one; a rim where the surface does not go on; an outline that
    ends; pixels, by their logarithm; hue, the log ratio of `judge.hue`."""
    return {
        "fit": seen.fit,
        "color": -max(seen.contrast / (seen.contrast + PLAIN) - seen.texture, 0.0),
        "free_rim": 1.0 - seen.rim,
        "ends": -seen.goes_on,
        "pixels": log(min(max(seen.pixels, FEWEST_PIXELS), ENOUGH_PIXELS)),
        "hue": hue,
    }


@dataclass(frozen=True, eq=False)
class Light:
    """shift (2,): what the light adds to colour opponents; spread: how well that is known."""

    shift: Float64
    spread: float


def logits_of(names: Sequence[str], sights: Sequence[Sight], fit: Logistic | None = None) -> Float64:
    """Logit (N,) of each sight of a frame, each of a named object, all of them seen in one light."""
    fit = fit or presence_fit()
    by_shape = np.array([fit.log_odds(features(s)) for s in sights])
    hues = hues_of(names, sights, by_shape)
    return np.array([fit.log_odds(features(s, hue)) for s, hue in zip(sights, hues, strict=True)])


def hues_of(names: Sequence[str], sights: Sequence[Sight], logits: Float64) -> Float64:
    """What hue says about each sight (N,), in the light that sights of other objects agree on, which are
    believed by their logits (N,)."""
    shifts = np.array([s.shift for s in sights]).reshape(-1, 2)
    each = np.array(names)
    lights = {name: light_of(logits[each != name], shifts[each != name]) for name in set(names)}
    return np.array(
        [
            hue_log_ratio(s.hues, lights[name].shift, lights[name].spread)
            for name, s in zip(names, sights, strict=True)
        ]
    )


def light_of(logits: Float64, shifts: Float64) -> Light:
    """What places say about the light of the frame, each by its probability (logits (N,)) and by how the hue
    there differs from the object's (N, 2); with none it is white, roughly."""
    known = np.isfinite(shifts).all(1)
    chances, shifts = probabilities(logits[known]), shifts[known]
    mean, weights = np.zeros(2), chances
    for _ in range(5):
        weights = chances * np.exp(-((shifts - mean) ** 2).sum(1) / (2.0 * LIGHT_REACH**2))
        mean = weights @ shifts / (weights.sum() + (LIGHT_NOISE / LIGHT_SPREAD) ** 2)
    return Light(mean, float((1.0 / LIGHT_SPREAD**2 + weights.sum() / LIGHT_NOISE**2) ** -0.5))
