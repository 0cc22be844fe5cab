"""What is seen of an object where a pose says that it is, in a clear view of the whole frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from huepose.believe.presence import Sight, logits_of
from huepose.geometry.arrays import Float64
from huepose.judge.arrays import model_arrays
from huepose.judge.continuation import continuation_many
from huepose.judge.hue import hue_samples
from huepose.judge.region import Region
from huepose.judge.terms import score_many
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView

SAMPLES, RIM_SAMPLES = 800, 400
"""Of the surface, and of its outline, by which a place is looked at."""


def presences(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Sequence[tuple[str, Float64]]
) -> Float64:
    """Logit (N,) of the probability for each named object that it is where its pose T_cam_obj (4, 4) says, in
    whatever turn."""
    regions = {name: view.region(models[name].diameter_m) for name, _ in poses}
    sights = [sight(view, regions[name], models[name], T) for name, T in poses]
    return logits_of([name for name, _ in poses], sights)


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
