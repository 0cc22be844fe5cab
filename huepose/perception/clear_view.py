"""A frame as the detector looks at it: planes taken away, colours as opponents."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.geometry.arrays import Bool, Float32, Float64, Int32, UInt8
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.judge.region import COLOR_SCALES_M, SATURATED, Crop, Region, tolerance_m
from huepose.perception.embedded import depth_steps
from huepose.perception.ground import large_planes, standing_clear
from huepose.support.jit import jit

FAR_M = 9.0
"""The depth that pixels of a plane get: an object that claims them is seen through there."""

SPECK_M2 = 1e-4
"""A piece of less than a square centimetre is noise."""

MARGIN_PX = 12.0
WIDE_PX = 1.5
"""A blur of this deviation needs no more than every second pixel."""


@dataclass(frozen=True, eq=False)
class ClearView:
    """The part of a frame where something stands. frame: all of it, as it came; crop: that part, depth of
    planes moved far away; clear (h, w): pixels that stand clear of planes; colors (2, h, w, 3) float32:
    opponents at two scales, as in `judge.region`; pieces (P, 4): of the parts without a step in depth: pixel
    of the middle, mean depth, the longer side of the bounds in metres."""

    frame: RgbdFrame
    crop: Crop
    clear: Bool
    colors: Float32
    pieces: Float64

    @property
    def depth(self) -> Float32:
        """Depth (h, w) of the part, planes where they are."""
        c = self.crop
        h, w = c.depth.shape
        return self.frame.depth[c.y0 : c.y0 + h, c.x0 : c.x0 + w]

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
    """The frame without planes of which more is seen than the square of the largest diameter; None where
    nothing is left."""
    planes = large_planes(frame.depth, frame.camera, largest_m**2)
    standing = standing_clear(frame.depth, frame.camera, planes, largest_m**2)
    clear, pieces = _pieces(frame.depth, standing, frame.camera.fx)
    bounds = Box.of_mask(clear)
    if bounds is None:
        return None
    width, height = frame.camera.width, frame.camera.height
    rows, columns = bounds.grown(0.0, MARGIN_PX).slices(width, height)
    depth, clear = frame.depth[rows, columns].copy(), np.ascontiguousarray(clear[rows, columns])
    depth[~clear & (depth > 0)] = FAR_M
    color = np.ascontiguousarray(frame.color[rows, columns])
    camera: Camera = frame.camera.cropped(columns.start, rows.start, depth.shape[1], depth.shape[0])
    saturated = (color[..., 0] >= SATURATED) | (color[..., 1] >= SATURATED) | (color[..., 2] >= SATURATED)
    crop = Crop(camera, columns.start, rows.start, color, depth, np.asarray(saturated))
    pieces[:, :2] -= columns.start, rows.start
    colors = _smoothed(color, camera.fx / float(np.median(depth[clear])))
    return ClearView(frame, crop, clear, colors, pieces)


def _pieces(depth: Float32, clear: Bool, focal: float) -> tuple[Bool, Float64]:
    """What stands clear without specks (H, W), and its pieces (P, 4)."""
    opened = cv2.morphologyEx(clear.view(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    free = opened & ~depth_steps(depth)
    count, labels, stats, middles = cv2.connectedComponentsWithStats(free.view(np.uint8), connectivity=4)
    size = np.maximum(stats[:, 4], 1)
    mean_m = _sums(np.asarray(labels, np.int32), depth, count) / size
    kept = size * (mean_m / focal) ** 2 >= SPECK_M2
    # The far sides of steps belong to no piece, but to what is beside them.
    near = cv2.dilate(kept[labels].view(np.uint8), np.ones((5, 5), np.uint8)) > 0
    side_m = np.maximum(stats[:, 2], stats[:, 3]) * mean_m / focal
    return near & opened, np.column_stack([middles, mean_m, side_m])[kept]


@jit
def _sums(labels: Int32, depth: Float32, count: int) -> Float64:
    """Of the depth of each label (count,), but for label 0."""
    sums = np.zeros(count)
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            if labels[v, u] > 0:
                sums[labels[v, u]] += depth[v, u]
    return sums


def _smoothed(color: UInt8, pixels_per_m: float) -> Float32:
    """Opponents (2, h, w, 3) float32 smoothed at the two scales of the texture."""
    plain = opponents_of_bytes(color)
    fine, coarse = (max(0.5, sigma_m * pixels_per_m) for sigma_m in COLOR_SCALES_M)
    out = np.empty((2, *plain.shape), np.float32)
    cv2.GaussianBlur(plain, (0, 0), fine, dst=out[0])
    _blur(plain, coarse, out[1])
    return out


def _blur(picture: Float32, sigma: float, out: Float32) -> None:
    """A Gaussian of the picture into `out`; where it is wide, of every second pixel."""
    if sigma < WIDE_PX:
        cv2.GaussianBlur(picture, (0, 0), sigma, dst=out)
        return
    height, width = picture.shape[:2]
    half = cv2.resize(picture, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    # Taking means of two pixels and going back between the means blurs a little, too.
    half = cv2.GaussianBlur(half, (0, 0), 0.5 * (sigma**2 - 0.75) ** 0.5)
    cv2.resize(half, (width, height), dst=out, interpolation=cv2.INTER_LINEAR)
