"""A frame as the detector looks at it: planes taken away, colours as opponents."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.perception.depth_pieces import depth_steps, median_depths
from huepose.perception.ground import large_planes, standing_clear
from huepose.verification.region import COLOR_SCALES_M, SATURATED, Crop, Region, tolerance_m

FAR_M = 9.0
"""The depth that pixels of a plane get: an object that claims them is seen through there."""

PLANE_FACTOR = 1.0
"""A plane of which more is seen than this times the square of the largest diameter is none of the objects."""


MIN_PIXELS = 25


@dataclass(frozen=True, eq=False)
class ClearView:
    """The part of a frame where something stands. crop: that part, depth of planes moved far away; clear
    (h, w): pixels that stand clear of planes; colors (h, w, 6) float32: opponents at two scales, as in
    `verification.region`; pieces (P, 4): of the parts without a step in depth: pixel of the middle, median
    depth, the longer side of the bounds in metres; size: width and height of the whole frame."""

    crop: Crop
    clear: Bool
    colors: Float32
    pieces: Float64
    size: tuple[int, int]

    def region(self, diameter_m: float) -> Region:
        """All of the view as a region to judge poses of an object in, without any outline."""
        h, w = self.clear.shape
        return Region(
            self.crop,
            np.zeros((h, w), np.float32),
            self.clear,
            self.colors,
            np.zeros((0, 3)),
            np.zeros(0),
            0.0,
            np.array([-2.0, -2.0, -1.0, -1.0]),
            tolerance_m(diameter_m, 1.0),
            1.0,
        )


def clear_view(frame: RgbdFrame, largest_m: float) -> ClearView | None:
    """The frame without planes that are larger than the largest object; None where nothing is left."""
    planes = large_planes(frame.depth, frame.camera, PLANE_FACTOR * largest_m**2)
    clear = standing_clear(frame.depth, frame.camera, planes)
    opened = cv2.morphologyEx(clear.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    bounds = Box.of_mask(opened)
    if bounds is None:
        return None
    width, height = frame.camera.width, frame.camera.height
    rows, columns = bounds.grown(0.0, 12.0).slices(width, height)
    depth = frame.depth[rows, columns].copy()
    clear = opened[rows, columns]
    depth[~clear & (depth > 0)] = FAR_M
    color = np.ascontiguousarray(frame.color[rows, columns])
    camera: Camera = frame.camera.cropped(columns.start, rows.start, depth.shape[1], depth.shape[0])
    crop = Crop(camera, columns.start, rows.start, color, depth, np.asarray((color >= SATURATED).any(-1)))
    middle_m = float(np.median(depth[clear]))
    colors = _smoothed(color, camera.fx / middle_m)
    return ClearView(crop, clear, colors, _pieces(depth, clear, camera.fx), (width, height))


def _pieces(depth: Float32, clear: Bool, focal: float) -> Float64:
    free = clear & ~depth_steps(depth)
    count, labels, stats, middles = cv2.connectedComponentsWithStats(free.astype(np.uint8), connectivity=4)
    keep = np.flatnonzero((stats[:, 4] >= MIN_PIXELS) & (np.arange(count) > 0))
    number = np.full(count, -1, np.int32)
    number[keep] = np.arange(len(keep))
    medians = median_depths(depth, number[labels], len(keep))
    side_m = np.maximum(stats[keep, 2], stats[keep, 3]) * medians / focal
    return np.column_stack([middles[keep], medians, side_m])


def _smoothed(color: UInt8, pixels_per_m: float) -> Float32:
    """Opponents (h, w, 6) float32 smoothed at the two scales of the print."""
    plain = opponents_of_bytes(color)
    out = np.empty((*color.shape[:2], 6), np.float32)
    for scale, sigma_m in enumerate(COLOR_SCALES_M):
        sigma = max(0.5, sigma_m * pixels_per_m)
        out[..., 3 * scale : 3 * scale + 3] = cv2.GaussianBlur(plain, (0, 0), sigma)
    return out
