"""What the full method looks at: one crop, seen through all candidate masks at once.

Each mask is believed as far as its bounds fit the box; the whole box is a further, silent candidate, which
proposes poses but is not believed. So a wrong mask costs little: it proposes in vain and loses the vote.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.judge.region import Crop, Region, prepare_believed, prepare_crop, sampled_points
from huepose.propose.config import EvidenceConfig
from huepose.propose.views import Picture


@dataclass(frozen=True, eq=False)
class Evidence:
    """region: what judges poses; picture: where views are sought; sources: masks (h, w) of the crop that
    propose poses, the whole box last; points_cam: of each source, (N, 3)."""

    region: Region
    picture: Picture
    sources: tuple[Bool, ...]
    points_cam: tuple[Float64, ...]


def gather(
    frame: RgbdFrame,
    masks: Sequence[Bool],
    box: Box,
    diameter_m: float,
    config: EvidenceConfig | None = None,
) -> Evidence | None:
    """Evidence of candidate masks (H, W) in a box; None when there is no depth under any mask nor in the
    box."""
    config = config or EvidenceConfig()
    size = (frame.camera.width, frame.camera.height)
    inside = np.zeros(frame.depth.shape, bool)
    inside[box.slices(*size)] = True
    known = frame.depth > 0
    shown = [m & known for m in masks]
    shown = [m for m in shown if m.any()]
    whole = inside & known
    if not shown and not whole.any():
        return None
    believed = shown or [whole]
    crop = prepare_crop(frame, _window(frame, [*shown, whole], config.reach * diameter_m))
    fits = [_fit(mask, box, config.fitting_iou) for mask in believed]
    region = prepare_believed(
        crop, believed, [f * f + config.least_trust for f in fits], max(fits) ** 2, box, diameter_m
    )
    if region is None:
        return None
    h, w = crop.depth.shape
    cut = (slice(crop.y0, crop.y0 + h), slice(crop.x0, crop.x0 + w))
    sources = [m[cut] for m in shown]
    counts = [config.mask_points] * len(sources)
    if whole[cut].any():
        sources.append(whole[cut])
        counts.append(config.box_points)
    points = tuple(sampled_points(crop, m, n)[0] for m, n in zip(sources, counts, strict=True))
    return Evidence(region, _picture(crop, region), tuple(sources), points)


def _picture(crop: Crop, region: Region) -> Picture:
    return Picture(crop.color, crop.depth, crop.camera, region.bounds)


def _fit(mask: Bool, box: Box, fitting_iou: float) -> float:
    """How well a mask fits the box, 0..1: as well as can be expected from this IoU of their bounds on."""
    bounds = Box.of_mask(mask)
    return 0.0 if bounds is None else min(1.0, bounds.iou(box) / fitting_iou)


def _window(frame: RgbdFrame, masks: Sequence[Bool], reach_m: float) -> Box:
    """A window that reaches so far beyond each mask, at the mask's depth."""
    boxes = []
    for mask in masks:
        bounds = Box.of_mask(mask)
        if bounds is not None:
            reach = reach_m / float(np.median(frame.depth[mask])) * frame.camera.fx
            boxes.append(bounds.grown(0.0, reach).clipped(frame.camera.width, frame.camera.height))
    left, top = min(b.x for b in boxes), min(b.y for b in boxes)
    right, bottom = max(b.x1 for b in boxes), max(b.y1 for b in boxes)
    return Box(left, top, right - left, bottom - top)
