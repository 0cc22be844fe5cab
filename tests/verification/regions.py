"""What several tests of verification look at."""

import numpy as np

from huepose.geometry import Box, RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose.verification.region import Region, prepare_region


def region_of(frame: RgbdFrame, model: ReferenceModel, T: np.ndarray) -> Region:
    """The region of the true mask in the true box."""
    mask = render_depth(model.mesh, T, frame.camera) > 0
    box = Box.of_mask(mask)
    assert box is not None
    region = prepare_region(frame, mask, box, model.diameter_m)
    assert region is not None
    return region
