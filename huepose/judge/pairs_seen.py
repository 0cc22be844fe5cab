"""Which colour pairs of a model an image shows at a pose, and which of them it contradicts: for display."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.pairs import pair_arrays, pair_image
from huepose.judge.region import Region, prepare_crop, smoothed_opponents
from huepose.judge.silhouette import projected_box
from huepose.judge.texture_evidence import contrasts
from huepose.model.types import ReferenceModel

PAIRS = 400
"""Pairs of a model that are compared: more of them would cover the image."""

CLEAR = 0.4
"""Least clarity of a contrast that is shown, 0..1: fainter ones say nothing for or against a pose."""


def pairs_seen(frame: RgbdFrame, model: ReferenceModel, T_cam_obj: Float) -> tuple[Float64, Bool]:
    """Pixels (N, 2) of the model's pairs that are visible at a pose (4, 4) and whose contrast is clear in
    texture and image; and whether the image's contrast points to another colour (N,). That is evidence
    against the pose, see `texture_evidence.contrast_disagreement`."""
    box = projected_box(model, frame, T_cam_obj)
    if box is None:
        return np.zeros((0, 2)), np.zeros(0, bool)
    crop = prepare_crop(frame, box.grown(0.1, 4.0))
    size, middle_m = crop.depth.shape, float(se3.apply(T_cam_obj, model.mesh.centre[None])[0, 2])
    colors = smoothed_opponents(crop.color, np.ones(size, np.float32), (1.0, 3.0))
    region = Region.whole(crop, np.zeros(size, bool), colors, model.diameter_m, middle_m)
    clarity, elsewhere = contrasts(model, region, pair_image(model, crop, middle_m), T_cam_obj, PAIRS)
    shown = clarity > CLEAR
    points = pair_arrays(model.pairs, PAIRS).points[shown]
    return frame.camera.project(se3.apply(T_cam_obj, points)), elsewhere[shown]
