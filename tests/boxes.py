"""Where an object is seen."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Box, RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth


def box_of(frame: RgbdFrame, model: ReferenceModel, T_cam_obj: np.ndarray) -> Box:
    """The bounds of all of it."""
    box = Box.of_mask(render_depth(model.mesh, T_cam_obj, frame.camera) > 0)
    assert box is not None
    return box
