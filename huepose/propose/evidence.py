"""Input of the method `full`: one crop of the frame, with all candidate masks.

Each mask is weighted by how well its bounds fit the box. The whole box is a further candidate, which proposes
poses but has no weight when they are judged. So a wrong mask costs little: its proposals score low.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float64, median
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.judge.region import Region, prepare_believed, prepare_crop, sampled_points

FITTING_IOU = 0.75
"""IoU of a mask's bounds and the box from which on the mask gets full weight: a true mask reaches it in a
box that is shifted and scaled by a tenth. Chosen."""

LEAST_TRUST = 0.05
"""Weight of a mask that does not overlap the box at all. Chosen."""

MASK_POINTS, BOX_POINTS = 400, 800
"""Surface points sampled for registration from each mask and from the whole box."""

REACH = 0.7
"""Margin of the crop around a mask, in object diameters at the mask's depth, so that the whole object lies
in the crop. A mask of only one end of a thin object would need 1.0. Chosen."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """region: the region that poses are judged in; sources: masks (h, w) of its crop that propose poses,
    the whole box last; points_cam: surface points (N, 3) of each source, metres."""

    region: Region
    sources: tuple[Bool, ...]
    points_cam: tuple[Float64, ...]


def gather(frame: RgbdFrame, masks: Sequence[Bool], box: Box, diameter_m: float) -> Evidence | None:
    """Crop a frame for candidate masks (H, W) bool and a box; None if neither has any depth."""
    size = (frame.camera.width, frame.camera.height)
    inside = np.zeros(frame.depth.shape, bool)
    inside[box.slices(*size)] = True
    known = frame.depth > 0
    masks_with_depth = [m & known for m in masks]
    masks_with_depth = [m for m in masks_with_depth if m.any()]
    whole = inside & known
    if not masks_with_depth and not whole.any():
        return None
    believed = masks_with_depth or [whole]
    shown = [(mask, Box.of_mask(mask)) for mask in (*masks_with_depth, whole)]
    crop = prepare_crop(frame, _window(frame, shown, REACH * diameter_m))
    fits = [_box_fit(bounds, box) for _, bounds in shown[: len(believed)]]
    region = prepare_believed(
        crop, believed, [f * f + LEAST_TRUST for f in fits], max(fits) ** 2, box, diameter_m
    )
    if region is None:
        return None
    h, w = crop.depth.shape
    cut = (slice(crop.y0, crop.y0 + h), slice(crop.x0, crop.x0 + w))
    sources = [m[cut] for m in masks_with_depth]
    counts = [MASK_POINTS] * len(sources)
    if whole[cut].any():
        sources.append(whole[cut])
        counts.append(BOX_POINTS)
    points = tuple(sampled_points(crop, m, n)[0] for m, n in zip(sources, counts, strict=True))
    return Evidence(region, tuple(sources), points)


def _box_fit(bounds: Box | None, box: Box) -> float:
    """Fit of a mask to the box, 0..1: IoU of its bounds over FITTING_IOU, at most 1."""
    return 0.0 if bounds is None else min(1.0, bounds.iou(box) / FITTING_IOU)


def _window(frame: RgbdFrame, masks: Sequence[tuple[Bool, Box | None]], reach_m: float) -> Box:
    """The bounds of all masks, each grown by `reach_m` at its median depth, clipped to the image."""
    boxes = []
    for mask, bounds in masks:
        if bounds is not None:
            cut = bounds.slices(frame.camera.width, frame.camera.height)
            reach = reach_m / median(frame.depth[cut][mask[cut]]) * frame.camera.fx
            boxes.append(bounds.grown(0.0, reach).clipped(frame.camera.width, frame.camera.height))
    return Box.around(*boxes)
