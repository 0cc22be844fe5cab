"""What is seen of an object where a pose says that it is, in a clear view of the whole frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from huepose.believe.presence import MOST_ALIKE, Sight, logits_of
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.arrays import model_arrays, nearest_view
from huepose.judge.borders import Contours, outline
from huepose.judge.continuation import continuation_many
from huepose.judge.region import Region
from huepose.judge.terms import Terms, score_many
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView
from huepose.perception.likeness import likenesses
from huepose.perception.scouting import SEEN_M

SAMPLES, RIM_SAMPLES = 800, 400
"""Of the surface, and of its outline, by which a place is looked at."""

NEAREST_M = 0.02

WORTH = -3.0
"""Log-odds under which nobody looks closer at a place: one of 2 % is not proposed."""


def presences(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Sequence[tuple[str, Float64]]
) -> Float64:
    """Logit (N,) of the probability for each named object that it is where its pose T_cam_obj (4, 4) says. A
    pose that is turned the wrong way looks less like it, and a plain thing the same."""
    return logits_of(sights_of(view, models, poses))


def sights_of(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Sequence[tuple[str, Float64]]
) -> list[Sight]:
    """What is seen of each named object at its pose T_cam_obj (4, 4), only as closely as it is doubtful."""
    regions = {name: view.region(models[name].diameter_m) for name, _ in poses}
    sights = [sight(view, regions[name], models[name], T) for name, T in poses]
    # Until they are asked for, likeness and outline say the best that they could.
    for closer in (alike, outlined):
        doubtful = [int(k) for k in np.flatnonzero(logits_of(sights) > WORTH)]
        asked = closer(view, models, [poses[k] for k in doubtful], [sights[k] for k in doubtful])
        for k, seen in zip(doubtful, asked, strict=True):
            sights[k] = seen
    return sights


def sight(view: ClearView, region: Region, model: ReferenceModel, T_cam_obj: Float64) -> Sight:
    """Look at a pose (4, 4), but not along its outline, nor by codes; `region`: the view as one for this
    model."""
    T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
    terms = Terms(*(float(x) for x in score_many(model, region, T[None], SAMPLES)[0]))
    crop, arrays = view.crop, model_arrays(model)
    rim = continuation_many(arrays, crop.depth, view.clear, crop.camera, T[None], RIM_SAMPLES)[0]
    pixels = agreeing_pixels(model, view.frame, T)
    return Sight(terms.depth_fit, terms.color, terms.contrast, float(rim), 0.0, MOST_ALIKE, pixels)


Named = Sequence[tuple[str, Float64]]
"""Objects with their poses T_cam_obj (4, 4)."""


def alike(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Named, sights: Sequence[Sight]
) -> list[Sight]:
    """The sights of poses, with how much what is seen there looks like the object."""
    found = likenesses(view, models, poses)
    return [replace(s, likeness=float(x)) for s, x in zip(sights, found, strict=True)]


def outlined(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Named, sights: Sequence[Sight]
) -> list[Sight]:
    """The sights of poses, with what is seen along their outlines."""
    return [
        replace(s, goes_on=outline(Contours.of(models[name]), T, view.frame).goes_on)
        for s, (name, T) in zip(sights, poses, strict=True)
    ]


def agreeing_pixels(model: ReferenceModel, frame: RgbdFrame, T_cam_obj: Float64) -> int:
    """How many pixels of a frame some of the samples of a pose (4, 4) fall on and agree with in depth."""
    arrays, camera = model_arrays(model), frame.camera
    view = nearest_view(T_cam_obj, arrays)
    shown = arrays.visible[arrays.offsets[view] : arrays.offsets[view + 1]][:SAMPLES]
    points = arrays.points[shown] @ T_cam_obj[:3, :3].T + T_cam_obj[:3, 3]
    points = points[points[:, 2] > NEAREST_M]
    u, v = np.rint(camera.project(points)).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    u, v, z = u[inside], v[inside], points[inside, 2]
    agree = np.abs(frame.depth[v, u] - z) < SEEN_M
    return len(np.unique(v[agree] * camera.width + u[agree]))
