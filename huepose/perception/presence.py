"""Measures the evidence that an object is at a pose, for the probability of its presence
(`believe.presence`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from huepose.believe.presence import MOST_ALIKE, MOST_VERIFIED, Sight, logits_of
from huepose.geometry.arrays import Float64
from huepose.geometry.camera import NEAR_M
from huepose.geometry.frame import RgbdFrame
from huepose.judge.borders import Contours, continuation_many, continued
from huepose.judge.kernel_arrays import model_arrays
from huepose.judge.region import Region
from huepose.judge.terms import CLOSE_SAMPLES, Terms, score_many
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView, thin
from huepose.perception.scouting import visible_pixels
from huepose.perception.verification import Images, verified
from huepose.propose.templates import SPAN
from huepose.propose.view_codes import codes_of_images, codes_of_windows
from huepose.propose.view_images import clean_view, window_images
from huepose.propose.views import onto_rays

RIM_SAMPLES = 400
"""Samples of the outline."""

WORTH = -3.0
"""Log-odds below which the more expensive terms are not computed: a probability of 5 %."""


Named = Sequence[tuple[str, Float64]]
"""Objects with their poses T_cam_obj (4, 4)."""


def sights_of(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Named, verifying: bool
) -> list[Sight]:
    """The evidence for each named object at its pose T_cam_obj (4, 4). The more expensive terms, of the
    outline and of networks, are computed only where the object may still be. verifying: whether the poses
    are refined, and so verified."""
    regions = {name: view.with_planes.region(models[name].diameter_m) for name, _ in poses}
    sights = [sight(view, regions[name], models[name], T) for name, T in poses]
    if not verifying:
        sights = [replace(s, verified=None) for s in sights]
    # Terms that are not computed yet have their best value.
    for closer in (outlined, alike):
        doubtful = [int(k) for k in np.flatnonzero(logits_of(sights) > WORTH)]
        asked = closer(view, models, [poses[k] for k in doubtful], [sights[k] for k in doubtful])
        for k, better in zip(doubtful, asked, strict=True):
            sights[k] = better
    if not verifying:
        return sights
    # Poses that are too improbable are not verified: the network says nothing about them.
    return [s if k in doubtful else replace(s, verified=0.0) for k, s in enumerate(sights)]


def sight(view: ClearView, region: Region, model: ReferenceModel, T_cam_obj: Float64) -> Sight:
    """The evidence for a pose (4, 4) without outline and codes. region: `view.with_planes.region` for this
    model."""
    T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
    terms = Terms.of(score_many(model, region, T[None], CLOSE_SAMPLES)[0])
    crop, arrays = view.crop, model_arrays(model)
    rim = continuation_many(arrays, crop.depth, view.clear, crop.camera, T[None], RIM_SAMPLES)[0]
    pixels = agreeing_pixels(model, view.frame, T)
    return Sight(
        fit=terms.depth_fit,
        texture=terms.color,
        contrast=terms.contrast,
        rim=float(rim),
        goes_on=0.0,
        likeness=MOST_ALIKE,
        verified=MOST_VERIFIED,
        pixels=pixels,
    )


def alike(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Named, sights: Sequence[Sight]
) -> list[Sight]:
    """The evidence with what networks say about the window and the object in its pose: likeness of their
    codes, and verification if it is asked for."""
    if not sights:
        return []
    windows, views = windows_and_views(view, models, poses)
    likeness = (codes_of_images(*views) * codes_of_windows(*windows)).sum(1)
    out = [replace(s, likeness=float(x)) for s, x in zip(sights, likeness, strict=True)]
    if sights[0].verified is None:
        return out
    return [replace(s, verified=float(x)) for s, x in zip(out, verified(windows, views), strict=True)]


def outlined(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Named, sights: Sequence[Sight]
) -> list[Sight]:
    """The evidence with the term of the outline. A thin object goes without: it may lie on something, so
    depth says nothing about its outline."""
    return [
        s if thin(models[name]) else replace(s, goes_on=continued(Contours.of(models[name]), T, view.frame))
        for s, (name, T) in zip(sights, poses, strict=True)
    ]


def agreeing_pixels(model: ReferenceModel, frame: RgbdFrame, T_cam_obj: Float64) -> int:
    """Number of pixels of a frame whose depth agrees with a surface sample of a pose (4, 4)."""
    return len(np.unique(visible_pixels(model, frame.depth, frame.camera, T_cam_obj, CLOSE_SAMPLES)[1]))


def windows_and_views(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Named
) -> tuple[Images, Images]:
    """The windows at each named object's pose T_cam_obj (4, 4), one or more, and the models rendered in
    these poses. A centre nearer than NEAR_M, or behind the camera, is moved to that depth."""
    clean, middles = [], []
    for name, T in poses:
        model = models[name]
        centre = T[:3, :3] @ model.mesh.centre + T[:3, 3]
        centre[2] = max(centre[2], NEAR_M)
        to_ray = onto_rays(centre[None] / centre[2])[0]
        clean.append(clean_view(model.mesh, model.diameter_m, to_ray.T @ T[:3, :3]))
        middles.append(centre + to_ray @ clean[-1].middle_m)
    middle, diameters = np.stack(middles), np.array([models[name].diameter_m for name, _ in poses])
    middle[:, 2] = np.maximum(middle[:, 2], NEAR_M)
    span_px = SPAN * diameters / middle[:, 2] * view.crop.camera.fx
    place = view.crop.camera.project(middle), middle[:, 2], span_px
    windows = window_images(view.pyramid, view.depth, *place, diameters)
    return windows, (np.stack([c.color for c in clean]), np.stack([c.relief for c in clean]))
