"""The bounding box of an object in the image."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Box, RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth


def box_of(frame: RgbdFrame, model: ReferenceModel, T_cam_obj: np.ndarray) -> Box:
    """The bounding box of the whole object, occluded parts included."""
    box = Box.of_mask(render_depth(model.mesh, T_cam_obj, frame.camera) > 0)
    assert box is not None
    return box
