"""What several tests of the judge look at."""

import numpy as np

from huepose.geometry import Box, RgbdFrame
from huepose.judge.pair_kernel import PairPicture
from huepose.judge.pair_terms import pair_picture
from huepose.judge.region import Region, prepare_region
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth


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
