"""The detector's view of a frame: large planes removed, cropped to the rest, with smoothed opponent
colours."""

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
from huepose.perception.stretches import connected, write_values
from huepose.propose.view_images import Pyramid
from huepose.support.jit import jit

FAR_M = 9.0
"""Depth assigned to pixels of planes, metres: a pose that covers them violates free space there."""

SPECK_M2 = 1e-4
"""Smallest piece of the depth, m^2: smaller ones are noise."""

MARGIN_PX = 12.0
"""Margin of the crop around what is left."""

WHOLE = slice(0, None), slice(0, None)
"""All rows and columns."""

THIN_M = 2.0 * (BAND_M + BAND_PER_M)
"""An object thinner than this, metres, may be removed with the plane that it lies on: at a distance of one
metre, a plane's noise reaches half as far."""

WIDE_PX = 1.5
"""From this standard deviation on, a blur is computed at half the resolution."""


@dataclass(frozen=True, eq=False)
class ClearView:
    """The part of a frame in which objects can be.

    frame: the whole frame, `filled`; crop: the part, with planes at FAR_M; clear (h, w): pixels that belong
    to no plane; colors (2, h, w, 3) float32: opponents at two scales, as in `judge.region`; pieces (P, 4):
    connected parts without a depth step, each with its centre pixel, mean depth and longer side, metres;
    depth (h, w): of the part as measured, planes included, metres; pyramid: of its colours; taken (h, w):
    pixels of known instances, which have no depth here, or None."""

    frame: RgbdFrame
    crop: Crop
    clear: Bool
    colors: Float32
    pieces: Float64
    depth: Float32
    pyramid: Pyramid
    taken: Bool | None = None

    def without(self, taken: Bool) -> ClearView:
        """The same view without the depth of the pixels (H, W) of the frame that belong to known
        instances."""
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
        """The same view in which the pixels of a plane that an object explains, at poses T_cam_obj (4, 4),
        are clear, as if it stood out of the plane."""
        c = self.crop
        h, w = c.depth.shape
        mine = taken_by(model, self.frame, poses)[c.y0 : c.y0 + h, c.x0 : c.x0 + w] & (self.depth > 0.0)
        return replace(
            self, crop=replace(c, depth=np.where(mine, self.depth, c.depth)), clear=self.clear | mine
        )

    def free(self, pixels: Float) -> Bool:
        """Which of pixels (N, 2) of the crop belong to no known instance."""
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
        """The same view, extended to the whole frame."""
        c, clear = self.crop, np.zeros(self.frame.depth.shape, bool)
        if self.clear.shape == clear.shape:
            return self
        clear[c.y0 : c.y0 + self.clear.shape[0], c.x0 : c.x0 + self.clear.shape[1]] = self.clear
        return _part(self.frame, clear, self.pieces + np.array([c.x0, c.y0, 0.0, 0.0]), *WHOLE)

    @cached_property
    def with_planes(self) -> ClearView:
        """The same view for judging poses that were found: pixels of planes have their depth, negative, and
        count neither for nor against a surface that lies in a plane. A thin thing on a table is within the
        table's noise."""
        taken_away = ~self.clear & (self.depth > 0.0)
        return replace(
            self, crop=replace(self.crop, depth=np.where(taken_away, -self.depth, self.crop.depth))
        )


def thin(model: ReferenceModel) -> bool:
    """Whether an object may be removed with the plane that it lies on."""
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
    """Like `clear_view`, but of the whole frame, even if nothing is left; None if it has no depth."""
    if not (frame.depth > 0.0).any():
        return None
    frame = filled(frame)
    return _part(frame, *_standing(frame, largest_m), *WHOLE)


def _standing(frame: RgbdFrame, largest_m: float) -> tuple[Bool, Float64]:
    """Mask (H, W) of what is clear of large planes, and its pieces (P, 4)."""
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
    """Mask (H, W) of what is clear, without specks, and its pieces (P, 4)."""
    opened = cv2.morphologyEx(clear.view(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    free = opened & ~depth_steps(depth)
    stretches, count = connected(free.view(np.uint8))
    sums, bounds = _measured(stretches, depth, count)
    size = sums[:, 0]
    middles, mean_m = sums[:, 1:3] / size[:, None], sums[:, 3] / size
    kept = size * (mean_m / focal) ** 2 >= SPECK_M2
    # The far side of a depth step belongs to no piece; it is kept as part of what is beside it.
    shown = np.zeros(depth.shape, np.uint8)
    write_values(stretches, kept.view(np.uint8), shown)
    near = cv2.dilate(shown, np.ones((5, 5), np.uint8)) > 0
    side_m = (bounds[:, 2:] - bounds[:, :2]).max(1) * mean_m / focal
    return near & opened, np.column_stack([middles, mean_m, side_m])[kept]


@jit
def _measured(stretches: Int32, depth: Float32, count: int) -> tuple[Float64, Int64]:
    """For each piece of some stretches: sums (count, 4) of its pixels, their columns, rows and depth;
    bounds (count, 4): left, top, right, bottom (exclusive)."""
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


def _blur(image: Float32, sigma: float, out: Float32) -> None:
    """Gaussian blur of an image into `out`, at half the resolution if it is wide."""
    if sigma < WIDE_PX:
        cv2.GaussianBlur(image, (0, 0), sigma, dst=out)
        return
    height, width = image.shape[:2]
    half = cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    # Averaging two pixels and interpolating back between the means also blurs a little.
    half = cv2.GaussianBlur(half, (0, 0), 0.5 * (sigma**2 - 0.75) ** 0.5)
    cv2.resize(half, (width, height), dst=out, interpolation=cv2.INTER_LINEAR)
