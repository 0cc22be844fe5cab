"""What several tests of verification look at."""

import numpy as np

from huepose.geometry import Box, RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose.verification.pairs import pair_picture
from huepose.verification.pairs_kernel import PairPicture
from huepose.verification.region import Region, prepare_region


def region_of(frame: RgbdFrame, model: ReferenceModel, T: np.ndarray) -> Region:
    """The region of the true mask in the true box."""
    mask = render_depth(model.mesh, T, frame.camera) > 0
    box = Box.of_mask(mask)
    assert box is not None
    region = prepare_region(frame, mask, box, model.diameter_m)
    assert region is not None
    return region


def seen_by_pairs(model: ReferenceModel, frame: RgbdFrame, T: np.ndarray) -> tuple[Region, PairPicture]:
    """That region, and the picture of its pairs."""
    region = region_of(frame, model, T)
    return region, pair_picture(model, region.crop, region.median_depth_m)
