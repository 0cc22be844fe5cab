"""Regions and pair scores that several tests of the judge use."""

from typing import NamedTuple

import numpy as np

from huepose.geometry import Box, RgbdFrame
from huepose.geometry.arrays import Bool
from huepose.judge.pairs import PairImage, pair_image
from huepose.judge.region import Region, prepare_believed, prepare_crop
from huepose.model.types import ReferenceModel
from huepose.paper.extended.pair_score import pair_score_many
from huepose.rendering.render import render_depth


def region_in(frame: RgbdFrame, mask: Bool, diameter_m: float) -> Region:
    """The region of a mask (H, W) in its box, in a crop that holds the whole object wherever the mask shows a
    part of it."""
    seen = mask & (frame.depth > 0)
    box, bounds = Box.of_mask(mask), Box.of_mask(seen)
    assert box is not None
    assert bounds is not None
    reach = 0.7 * diameter_m / float(np.median(frame.depth[seen])) * frame.camera.fx
    window = bounds.grown(0.0, reach).clipped(frame.camera.width, frame.camera.height)
    region = prepare_believed(prepare_crop(frame, window), [seen], [1.0], 1.0, box, diameter_m)
    assert region is not None
    return region


class PairScore(NamedTuple):
    """The terms of `pair_score_many` for one pose."""

    total: float
    geometry: float
    color: float
    contrast: float
    visible: float


def pair_score(
    model: ReferenceModel,
    region: Region,
    pairs_seen: PairImage,
    T: np.ndarray,
    pairs: int = 600,
    samples: int = 300,
) -> PairScore:
    """The score of one pose (4, 4)."""
    return PairScore(*pair_score_many(model, region, pairs_seen, T[None], pairs, samples)[0].tolist())


def region_of(frame: RgbdFrame, model: ReferenceModel, T: np.ndarray) -> Region:
    """The region of the true mask in the true box."""
    return region_in(frame, render_depth(model.mesh, T, frame.camera) > 0, model.diameter_m)


def seen_by_pairs(model: ReferenceModel, frame: RgbdFrame, T: np.ndarray) -> tuple[Region, PairImage]:
    """The region of the true mask, and its pair image."""
    region = region_of(frame, model, T)
    return region, pair_image(model, region.crop, region.median_depth_m)
