"""What judging a pose needs of a frame: a crop round the object, its colours smoothed at two scales.

The crop (colour conversion) is shared by all candidate masks of an object; a region is the crop seen
through one mask.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.verification.opponents import linear_rgb, opponents

COLOR_SCALES_M = (0.0010, 0.0035)
"""Standard deviations of the two smoothings, as in `Surface.lab`."""

SATURATED = 250
"""A channel at or over this says nothing of the colour any more."""

OUTSIDE_WEIGHT = 0.02
MASK_POINTS = 500


@dataclass(frozen=True, eq=False)
class Crop:
    """A part of a frame. camera: of the crop; x0, y0: its top-left pixel in the frame; color (h, w, 3) uint8
    RGB; depth (h, w) float32 metres; saturated (h, w) bool."""

    camera: Camera
    x0: int
    y0: int
    color: UInt8
    depth: Float32
    saturated: Bool


@dataclass(frozen=True, eq=False)
class Region:
    """A crop seen through a mask.

    mask (h, w): pixels of the mask that have depth; colors (h, w, 6) float32: opponents smoothed over about
    1 mm, then over 3.5 mm, inside the mask without a look outside; points_cam (N, 3) float64: at most 500 of
    the mask's points in random order, away from its rim; bounds (4,): left, top, right, bottom of the box in
    the crop; tolerance_m: how far depth and surface may be apart; median_depth_m: of the mask.
    """

    crop: Crop
    mask: Bool
    colors: Float32
    points_cam: Float64
    bounds: Float64
    tolerance_m: float
    median_depth_m: float


def prepare_crop(frame: RgbdFrame, window: Box) -> Crop:
    """Cut a window (clipped to the image, at least two pixels in each direction) out of a frame."""
    rows, columns = window.slices(frame.camera.width, frame.camera.height)
    x0 = min(columns.start, frame.camera.width - 2)
    y0 = min(rows.start, frame.camera.height - 2)
    x1, y1 = max(columns.stop, x0 + 2), max(rows.stop, y0 + 2)
    color = np.ascontiguousarray(frame.color[y0:y1, x0:x1])
    return Crop(
        frame.camera.cropped(x0, y0, x1 - x0, y1 - y0),
        x0,
        y0,
        color,
        np.ascontiguousarray(frame.depth[y0:y1, x0:x1]),
        np.asarray((color >= SATURATED).any(-1)),
    )


def prepare_region(frame: RgbdFrame, mask: Bool, box: Box, diameter_m: float) -> Region | None:
    """The region of a mask (H, W) in a box; None when no pixel of the mask has depth."""
    window = object_window(frame, mask, diameter_m)
    if window is None:
        return None
    return prepare_masked(prepare_crop(frame, window), mask, box, diameter_m)


def object_window(frame: RgbdFrame, mask: Bool, diameter_m: float) -> Box | None:
    """Bounds of a mask (H, W) grown by 0.7 diameters at its depth: the whole object lies inside, wherever the
    mask shows a part of it. None when no pixel of the mask has depth."""
    mask = mask & (frame.depth > 0)
    bounds = Box.of_mask(mask)
    if bounds is None:
        return None
    reach = 0.7 * diameter_m / float(np.median(frame.depth[mask])) * frame.camera.fx
    return bounds.grown(0.0, reach).clipped(frame.camera.width, frame.camera.height)


def prepare_masked(crop: Crop, mask: Bool, box: Box, diameter_m: float) -> Region | None:
    """See a crop through a mask (H, W) of the frame; None when no pixel of it has depth there."""
    h, w = crop.depth.shape
    seen = mask[crop.y0 : crop.y0 + h, crop.x0 : crop.x0 + w] & (crop.depth > 0)
    if not seen.any():
        return None
    median_depth = float(np.median(crop.depth[seen]))
    bounds = np.array(
        [box.x - crop.x0, box.y - crop.y0, box.x1 - crop.x0, box.y1 - crop.y0], dtype=np.float64
    )
    return Region(
        crop,
        seen,
        _masked_colors(crop, seen, median_depth),
        _mask_points(crop, seen),
        bounds,
        tolerance_m(diameter_m, median_depth),
        median_depth,
    )


def tolerance_m(diameter_m: float, depth_m: float) -> float:
    """How far depth and surface may be apart: 6 to 12 mm by the object's size, more where depth is far."""
    return max(0.006, min(0.012, 0.05 * diameter_m)) + (0.002 if depth_m > 1.1 else 0.0)


def _masked_colors(crop: Crop, mask: Bool, depth_m: float) -> Float32:
    """Opponent colours smoothed at both scales; a pixel outside of the mask counts little, so that inside
    the mask colours are the mask's, and outside those of the place."""
    weight = np.where(mask, np.float32(1.0), np.float32(OUTSIDE_WEIGHT))
    weighted = np.dstack([linear_rgb(crop.color) * weight[..., None], weight])
    out = np.empty((*mask.shape, 6), np.float32)
    for scale, sigma_m in enumerate(COLOR_SCALES_M):
        sigma = max(0.5, sigma_m / depth_m * crop.camera.fx)
        smooth = np.asarray(cv2.GaussianBlur(weighted, (0, 0), sigma), dtype=np.float32)
        out[..., 3 * scale : 3 * scale + 3] = opponents(smooth[..., :3] / smooth[..., 3:])
    return out


def _mask_points(crop: Crop, mask: Bool) -> Float64:
    """Camera-frame points (N, 3) of mask pixels in an order that depends on the mask alone."""
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if inner.sum() <= 120:
        inner = mask
    rows, columns = np.nonzero(inner)
    keep = np.random.default_rng(len(rows)).permutation(len(rows))[:MASK_POINTS]
    rows, columns = rows[keep], columns[keep]
    return crop.camera.backproject(np.stack([columns, rows], -1), crop.depth[rows, columns])
