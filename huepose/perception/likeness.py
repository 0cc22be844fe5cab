"""How much what is seen at a pose looks like the object in that pose, by the codes of views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView
from huepose.propose.view_codes import codes_of_pictures, codes_of_windows
from huepose.propose.view_pictures import SPAN, clean_view, window_pictures
from huepose.propose.views import onto_rays


def likenesses(
    view: ClearView, models: Mapping[str, ReferenceModel], poses: Sequence[tuple[str, Float64]]
) -> Float64:
    """Cosines (N,) of the codes of what is seen at each named object's pose T_cam_obj (4, 4) and of its model
    in that pose: 1 is the same, 0 nothing alike."""
    if not poses:
        return np.zeros(0)
    clean, windows = [], []
    camera = view.crop.camera
    for name, T in poses:
        model = models[name]
        centre = T[:3, :3] @ model.mesh.centre + T[:3, 3]
        turn = onto_rays(centre[None] / centre[2])[0]
        seen = clean_view(model.mesh, model.diameter_m, turn.T @ T[:3, :3])
        middle = centre + turn @ seen.middle_m
        span_px = SPAN * model.diameter_m / middle[2] * camera.fx
        place = camera.project(middle)[None], middle[2:], np.array([span_px])
        clean.append(seen)
        windows.append(window_pictures(view.crop.color, view.depth, *place, model.diameter_m))
    of_poses = codes_of_pictures(np.stack([c.color for c in clean]), np.stack([c.relief for c in clean]))
    colors, reliefs = (np.concatenate(part) for part in zip(*windows, strict=True))
    return np.asarray((of_poses * codes_of_windows(colors, reliefs)).sum(1), np.float64)
