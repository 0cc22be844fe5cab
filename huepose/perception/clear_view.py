"""The detector's view of a frame: large planes removed, cropped to the rest, colours as smoothed
opponents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.geometry.arrays import Bool, Float, Float32, Float64, Int32, Int64, UInt8, median
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.judge.region import Crop, Region, saturated
from huepose.judge.silhouette import taken_by
from huepose.model.types import COLOR_SCALES_M, ReferenceModel
from huepose.perception.embedded import depth_steps
from huepose.perception.filled import filled
from huepose.perception.planes import BAND_M, BAND_PER_M, large_planes, standing_clear
from huepose.perception.stretches import connected, written
from huepose.propose.view_pictures import Pyramid
from huepose.support.jit import jit

FAR_M = 9.0
"""Depth assigned to pixels of planes: a pose that covers them counts as seen through there."""

SPECK_M2 = 1e-4
"""Smallest piece of the depth, m^2: less than a square centimetre is noise."""

MARGIN_PX = 12.0
"""Margin of the crop round what is left."""

WHOLE = slice(0, None), slice(0, None)
"""Rows and columns."""

THIN_M = 2.0 * (BAND_M + BAND_PER_M)
"""An object that is thinner may be taken away with the plane it lies on: at a metre, a plane's noise reaches
half as far."""

WIDE_PX = 1.5
"""From this standard deviation on, a blur is computed at half the resolution."""


@dataclass(frozen=True, eq=False)
class ClearView:
    """The part of a frame in which something stands. frame: the whole, `filled`; crop: the part, with
    planes at FAR_M; clear (h, w): pixels that belong to no plane; colors (2, h, w, 3) float32: opponents at
    two scales, as in `judge.region`; pieces (P, 4): connected parts without a depth step: centre pixel, mean
    depth, and longer side in metres; depth (h, w): of the part as measured, planes included, metres; pyramid:
    of its colours. taken (h, w): pixels of something known, which have no depth here; None for none."""

    frame: RgbdFrame
    crop: Crop
    clear: Bool
    colors: Float32
    pieces: Float64
    depth: Float32
    pyramid: Pyramid
    taken: Bool | None = None

    def without(self, taken: Bool) -> ClearView:
        """The same view in which pixels (H, W) of the frame belong to something known: no depth is read
        there."""
        c = self.crop
        h, w = c.depth.shape
        mine = taken[c.y0 : c.y0 + h, c.x0 : c.x0 + w]
        of_crop, measured = (np.where(mine, np.float32(0.0), depth) for depth in (c.depth, self.depth))
        return replace(
            self,
            frame=self.frame.without(taken),
            crop=replace(c, depth=of_crop),
            clear=self.clear & ~mine,
            depth=measured,
            taken=mine,
        )

    def given_back(self, poses: Sequence[Float64], model: ReferenceModel) -> ClearView:
        """The same view in which what an object explains of a plane, at poses T_cam_obj (4, 4), is clear, as
        if it stood out of the plane."""
        c = self.crop
        h, w = c.depth.shape
        mine = taken_by(model, self.frame, poses)[c.y0 : c.y0 + h, c.x0 : c.x0 + w] & (self.depth > 0.0)
        return replace(
            self, crop=replace(c, depth=np.where(mine, self.depth, c.depth)), clear=self.clear | mine
        )

    def free(self, pixels: Float) -> Bool:
        """Which of pixels (N, 2) of the crop belong to nothing that is known."""
        if self.taken is None:
            return np.ones(len(pixels), bool)
        height, width = self.taken.shape
        x, y = np.clip(np.rint(pixels), 0, [width - 1, height - 1]).astype(np.int64).T
        return np.asarray(~self.taken[y, x])

    def region(self, diameter_m: float) -> Region:
        """The whole view as a region in which poses of an object are scored, without an outline."""
        return Region.whole(self.crop, self.clear, self.colors, diameter_m, 1.0)

    @cached_property
    def whole(self) -> ClearView:
        """The same view of the whole frame."""
        c, clear = self.crop, np.zeros(self.frame.depth.shape, bool)
        if self.clear.shape == clear.shape:
            return self
        clear[c.y0 : c.y0 + self.clear.shape[0], c.x0 : c.x0 + self.clear.shape[1]] = self.clear
        return _part(self.frame, clear, self.pieces + np.array([c.x0, c.y0, 0.0, 0.0]), *WHOLE)

    @cached_property
    def with_planes(self) -> ClearView:
        """The same view to judge poses that were found: planes have their depth, negative, and say nothing of
        a surface that lies in them. A thin thing on a table is within the table's noise."""
        taken_away = ~self.clear & (self.depth > 0.0)
        return replace(
            self, crop=replace(self.crop, depth=np.where(taken_away, -self.depth, self.crop.depth))
        )


def thin(model: ReferenceModel) -> bool:
    """Whether an object may be taken away with the plane it lies on."""
    return model.thickness_m < THIN_M


def clear_view(frame: RgbdFrame, largest_m: float) -> ClearView | None:
    """The view of a frame without planes larger than the square of the largest object's diameter, metres;
    None if nothing is left."""
    frame = filled(frame)
    clear, pieces = _standing(frame, largest_m)
    bounds = Box.of_mask(clear)
    if bounds is None:
        return None
    width, height = frame.camera.width, frame.camera.height
    return _part(frame, clear, pieces, *bounds.grown(0.0, MARGIN_PX).slices(width, height))


def whole_view(frame: RgbdFrame, largest_m: float) -> ClearView | None:
    """`clear_view` of all of a frame, even if nothing is left; None if it has no depth."""
    if not (frame.depth > 0.0).any():
        return None
    frame = filled(frame)
    return _part(frame, *_standing(frame, largest_m), *WHOLE)


def _standing(frame: RgbdFrame, largest_m: float) -> tuple[Bool, Float64]:
    """Mask (H, W) of what stands clear of large planes, and its pieces (P, 4)."""
    planes = large_planes(frame.depth, frame.camera, largest_m**2)
    return _pieces(frame.depth, standing_clear(frame.depth, frame.camera, planes, largest_m), frame.camera.fx)


def _part(frame: RgbdFrame, clear: Bool, pieces: Float64, rows: slice, columns: slice) -> ClearView:
    measured, clear = frame.depth[rows, columns].copy(), np.ascontiguousarray(clear[rows, columns])
    depth = np.where(clear | (measured <= 0.0), measured, np.float32(FAR_M))
    color = np.ascontiguousarray(frame.color[rows, columns])
    camera: Camera = frame.camera.cropped(columns.start, rows.start, depth.shape[1], depth.shape[0])
    crop = Crop(camera, columns.start, rows.start, color, depth, saturated(color))
    pieces[:, :2] -= columns.start, rows.start
    colors = _smoothed(color, camera.fx / median(depth[clear if clear.any() else depth > 0.0]))
    return ClearView(frame, crop, clear, colors, pieces, measured, Pyramid(color))


def _pieces(depth: Float32, clear: Bool, focal: float) -> tuple[Bool, Float64]:
    """Mask (H, W) of what stands clear, without specks, and its pieces (P, 4)."""
    opened = cv2.morphologyEx(clear.view(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    free = opened & ~depth_steps(depth)
    stretches, count = connected(free.view(np.uint8))
    sums, bounds = _measured(stretches, depth, count)
    size = sums[:, 0]
    middles, mean_m = sums[:, 1:3] / size[:, None], sums[:, 3] / size
    kept = size * (mean_m / focal) ** 2 >= SPECK_M2
    # The far sides of steps belong to no piece, but to what is beside them.
    shown = np.zeros(depth.shape, np.uint8)
    written(stretches, kept.view(np.uint8), shown)
    near = cv2.dilate(shown, np.ones((5, 5), np.uint8)) > 0
    side_m = (bounds[:, 2:] - bounds[:, :2]).max(1) * mean_m / focal
    return near & opened, np.column_stack([middles, mean_m, side_m])[kept]


@jit
def _measured(stretches: Int32, depth: Float32, count: int) -> tuple[Float64, Int64]:
    """Of each piece of some stretches: sums (count, 4) of its pixels, their columns, rows and depth; bounds
    (count, 4): left, top, right, bottom (exclusive)."""
    sums, bounds = np.zeros((count, 4)), np.zeros((count, 4), np.int64)
    for v, first, last, k in stretches:
        if sums[k, 0] == 0.0:
            bounds[k, 0], bounds[k, 1] = first, v
        sums[k, 0] += last - first
        for u in range(first, last):
            sums[k, 1] += u
            sums[k, 3] += depth[v, u]
        sums[k, 2] += v * (last - first)
        bounds[k, 0], bounds[k, 2] = min(bounds[k, 0], first), max(bounds[k, 2], last)
        bounds[k, 3] = v + 1
    return sums, bounds


def _smoothed(color: UInt8, pixels_per_m: float) -> Float32:
    """Opponent colours (2, h, w, 3) float32, smoothed at the two scales of the texture score."""
    plain = opponents_of_bytes(color)
    fine, coarse = (max(0.5, sigma_m * pixels_per_m) for sigma_m in COLOR_SCALES_M)
    out = np.empty((2, *plain.shape), np.float32)
    cv2.GaussianBlur(plain, (0, 0), fine, dst=out[0])
    _blur(plain, coarse, out[1])
    return out


def _blur(picture: Float32, sigma: float, out: Float32) -> None:
    """Gaussian blur of a picture into `out`, at half the resolution where it is wide."""
    if sigma < WIDE_PX:
        cv2.GaussianBlur(picture, (0, 0), sigma, dst=out)
        return
    height, width = picture.shape[:2]
    half = cv2.resize(picture, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    # Taking means of two pixels and going back between the means blurs a little, too.
    half = cv2.GaussianBlur(half, (0, 0), 0.5 * (sigma**2 - 0.75) ** 0.5)
    cv2.resize(half, (width, height), dst=out, interpolation=cv2.INTER_LINEAR)
