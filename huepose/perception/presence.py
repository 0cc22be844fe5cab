"""Is the object here at all, whichever way round it is?

Whether a pose is right asks for texture that tells it from its turns; a plain mug has none, and is there all
the same. What speaks for an object being there is a shape that explains the depth, without a surface that
goes on where the object ends, and colours that are the object's, up to the one light that all of the frame
has. How much a colour says depends on how common it is: grey is everywhere, a strong red is not.

The weighted sum of these is a logit; the weights, in `presence_fit.json`, were fitted on drawn scenes
(`studies.presence`). (The light: what probable places of the *other* objects say about
it, as log colours are only shifted by it, after von Kries.)
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.judge.arrays import model_arrays
from huepose.judge.continuation import continuation_many
from huepose.judge.hue import LEAST_HUES, hue_log_ratio, hue_samples
from huepose.judge.region import Region
from huepose.judge.terms import score_many
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView

SAMPLES, RIM_SAMPLES = 800, 400

LIGHT_SPREAD, LIGHT_NOISE, LIGHT_REACH = 15.0, 8.0, 25.0
"""Of the hue of lights; of a place's mean hue under it; places farther off than this say little about it."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What is seen where a pose says that an object is. fit, violation 0..1, texture -1..1: terms of the
    dense score; rim 0..1: where the surface goes on beside it; hues (N, 5): of samples that fit the depth,
    weight, the object's two colour opponents, and the picture's."""

    fit: float
    violation: float
    texture: float
    rim: float
    hues: Float64

    @property
    def shift(self) -> Float64:
        """Mean difference (2,) of the picture's hue from the object's; nan where hardly anything is seen."""
        if len(self.hues) < LEAST_HUES:
            return np.full(2, np.nan)
        return np.asarray(np.average(self.hues[:, 3:] - self.hues[:, 1:3], axis=0, weights=self.hues[:, 0]))


@dataclass(frozen=True)
class PresenceFit:
    """Weights of the logit, none of them negative but the constant, which speaks against any place: depth
    that fits; what is seen through, which the fit counts already, and too much; texture; a rim where the
    surface does not go on; hue."""

    constant: float
    fit: float
    violation: float
    texture: float
    free_rim: float
    hue: float

    def logit(self, seen: Sight) -> float:
        """Of the object being where it is looked for, by all but hue."""
        shape = self.fit * seen.fit + self.violation * seen.violation + self.free_rim * (1.0 - seen.rim)
        return shape + self.texture * seen.texture + self.constant


@cache
def presence_fit() -> PresenceFit:
    """The calibrated weights."""
    text = resources.files("huepose.perception").joinpath("presence_fit.json").read_text()
    return PresenceFit(**json.loads(text))


@dataclass(frozen=True, eq=False)
class Light:
    """shift (2,): what the light adds to colour opponents; spread: how well that is known."""

    shift: Float64
    spread: float


def presences(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Sequence[tuple[str, Float64]]
) -> Float64:
    """Logit (N,) of the probability for each named object that it is where its pose T_cam_obj (4, 4) says, in
    whatever turn."""
    regions = {name: view.region(models[name].diameter_m) for name, _ in poses}
    sights = [sight(view, regions[name], models[name], T) for name, T in poses]
    return logits_of([name for name, _ in poses], sights, presence_fit())


def logits_of(names: Sequence[str], sights: Sequence[Sight], weights: PresenceFit) -> Float64:
    """Logit (N,) of each sight of a frame, each of a named object, all of them seen in one light."""
    logits = np.array([weights.logit(s) for s in sights])
    return np.asarray(logits + weights.hue * hues_of(names, sights, logits))


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


def probability(logit: Float64 | np.float64) -> Float64:
    """Of a logit, or of logits (N,).

    >>> probability(np.array([0.0, np.log(3.0)])).round(2).tolist()
    [0.5, 0.75]
    """
    return np.asarray(1.0 / (1.0 + np.exp(-logit)))


def sight(view: ClearView, region: Region, model: ReferenceModel, T_cam_obj: Float64) -> Sight:
    """Look at a pose (4, 4); `region`: the view as one for this model."""
    T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
    terms = score_many(model, region, T[None], SAMPLES)[0]
    crop, arrays = view.crop, model_arrays(model)
    rim = continuation_many(arrays, crop.depth, view.clear, crop.camera, T[None], RIM_SAMPLES)[0]
    hues = hue_samples(arrays, crop.depth, view.colors, crop.saturated, crop.camera, region.tolerance_m, T)
    return Sight(
        float(terms[1]),
        float(terms[3]),
        float(terms[4]),
        float(rim),
        hues,
    )


def light_of(logits: Float64, shifts: Float64) -> Light:
    """What places say about the light of the frame, each by its probability (logits (N,)) and by how the hue
    there differs from the object's (N, 2); with none it is white, roughly."""
    known = np.isfinite(shifts).all(1)
    chances, shifts = probability(logits[known]), shifts[known]
    mean, weights = np.zeros(2), chances
    for _ in range(5):
        weights = chances * np.exp(-((shifts - mean) ** 2).sum(1) / (2.0 * LIGHT_REACH**2))
        mean = weights @ shifts / (weights.sum() + (LIGHT_NOISE / LIGHT_SPREAD) ** 2)
    return Light(mean, float((1.0 / LIGHT_SPREAD**2 + weights.sum() / LIGHT_NOISE**2) ** -0.5))
