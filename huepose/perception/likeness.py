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
    clean, middles = [], []
    for name, T in poses:
        model = models[name]
        centre = T[:3, :3] @ model.mesh.centre + T[:3, 3]
        turn = onto_rays(centre[None] / centre[2])[0]
        clean.append(clean_view(model.mesh, model.diameter_m, turn.T @ T[:3, :3]))
        middles.append(centre + turn @ clean[-1].middle_m)
    of_poses = codes_of_pictures(np.stack([c.color for c in clean]), np.stack([c.relief for c in clean]))
    middle, diameters = np.stack(middles), np.array([models[name].diameter_m for name, _ in poses])
    span_px = SPAN * diameters / middle[:, 2] * view.crop.camera.fx
    place = view.crop.camera.project(middle), middle[:, 2], span_px
    windows = codes_of_windows(*window_pictures(view.crop.color, view.depth, *place, diameters))
    return np.asarray((of_poses * windows).sum(1), np.float64)
