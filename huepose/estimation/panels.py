"""Small pictures that compare poses with a frame, for those who want to see why an estimate is as it is.

All panels of one page show the same window; dark images are brightened.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.drawing.depth_color import depth_to_color
from huepose.drawing.overlay import draw_mask_outline, tint
from huepose.geometry.arrays import Bool, Float, Float64, UInt8
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render

SIDE = 240
"""Longer side of a panel, pixels."""

MAX_GAIN = 8.0
"""Largest factor by which a dark image is brightened."""

AGREES, DIFFERS, SEEN_THROUGH, OCCLUDED, UNKNOWN = (
    (40, 190, 90),
    (250, 215, 60),
    (225, 50, 45),
    (70, 120, 230),
    (120, 120, 120),
)
"""Colours of a pose's pixels: depth fits and the texture agrees; depth fits, the texture differs; free-space
violation; occluded; no depth."""

LEGEND = "green: agrees, yellow: texture differs, red: free-space violation, blue: occluded, grey: no depth"

BOX, MASK, TRUTH = (250, 250, 250), (80, 220, 120), (255, 120, 220)
DIFFERENT = 16.0
"""Difference of opponents at which the texture plainly differs."""


@dataclass(frozen=True)
class Panels:
    """Draws a window of a frame. rows, columns: slices of the frame; tolerance_m: largest difference of depth
    and surface that fits."""

    frame: RgbdFrame
    rows: slice
    columns: slice
    tolerance_m: float

    @staticmethod
    def around(frame: RgbdFrame, box: Box, masks: Sequence[Bool], tolerance_m: float) -> Panels:
        """A window that holds a box and some masks (H, W), with a margin around them."""
        hull = Box.around(box, *(b for b in map(Box.of_mask, masks) if b is not None))
        camera = frame.camera
        rows, columns = hull.grown(0.12, 8.0).slices(camera.width, camera.height)
        if rows.stop - rows.start < 2 or columns.stop - columns.start < 2:
            rows, columns = slice(0, camera.height), slice(0, camera.width)
        return Panels(frame, rows, columns, tolerance_m)

    def photo(self, box: Box | None = None) -> UInt8:
        """The window of the image, with a box."""
        picture = self._photo()
        if box is not None:
            scale = self._scale
            corner = [round((box.x - self.columns.start) * scale), round((box.y - self.rows.start) * scale)]
            end = [corner[0] + round(box.w * scale), corner[1] + round(box.h * scale)]
            cv2.rectangle(picture, corner, end, BOX, 1)
        return picture

    def masks(self, mask: Bool | None, truth: Bool | None = None) -> UInt8:
        """The window with a mask (H, W) tinted, and the outline of the true mask."""
        picture = self._photo()
        if mask is not None:
            picture = tint(picture, self._enlarged(mask), MASK)
        if truth is not None:
            picture = draw_mask_outline(picture, self._enlarged(truth), TRUTH, 1)
        return picture

    def depth(self) -> UInt8:
        """The window of the depth in colours, black where there is none."""
        depth = self.frame.depth[self.rows, self.columns]
        return self._grown(depth_to_color(depth))

    def worn(self, model: ReferenceModel, T_cam_obj: Float) -> UInt8:
        """The object rendered at a pose over the dimmed image."""
        color, depth = self._rendered(model, T_cam_obj)
        dim = self._brightened() // 3
        return self._grown(np.where((depth > 0)[..., None], color, dim).astype(np.uint8))

    def judged(self, model: ReferenceModel, T_cam_obj: Float) -> UInt8:
        """Where a pose agrees with the frame and where it does not (see LEGEND)."""
        color, surface = self._rendered(model, T_cam_obj)
        seen = self.frame.depth[self.rows, self.columns]
        on, known = surface > 0, seen > 0
        fits = on & known & (np.abs(seen - surface) < self.tolerance_m)
        picture = self._brightened() // 3
        picture[on & ~known] = UNKNOWN
        picture[on & known & ~fits & (seen > surface)] = SEEN_THROUGH
        picture[on & known & ~fits & (seen < surface)] = OCCLUDED
        if fits.any():
            differs = self._difference(color, fits)[fits][:, None]
            picture[fits] = (1.0 - differs) * AGREES + differs * DIFFERS
        return self._grown(picture)

    def _difference(self, color: UInt8, fits: Bool) -> Float64:
        """How much the texture differs (h, w), 0..1, independent of the light's colour and strength."""
        seen, rendered = (
            opponents_of_bytes(np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.7), dtype=np.uint8))
            for picture in (self.frame.color[self.rows, self.columns], color)
        )
        gap = seen - rendered
        gap = (gap - np.median(gap[fits], axis=0)) * (0.5, 1.0, 1.0)
        return np.asarray(np.minimum(np.linalg.norm(gap, axis=-1) / DIFFERENT, 1.0))

    def _rendered(self, model: ReferenceModel, T_cam_obj: Float) -> tuple[UInt8, Float]:
        rows, columns = self.rows, self.columns
        camera = self.frame.camera.cropped(
            columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start
        )
        picture = render([(model.mesh, np.asarray(T_cam_obj))], camera)
        return picture.color, picture.depth

    @property
    def _scale(self) -> float:
        longest: int = max(self.rows.stop - self.rows.start, self.columns.stop - self.columns.start)
        return SIDE / longest

    def _photo(self) -> UInt8:
        return self._grown(self._brightened())

    def _brightened(self) -> UInt8:
        cut = self.frame.color[self.rows, self.columns]
        gain = min(MAX_GAIN, max(1.0, 235.0 / max(float(np.percentile(cut, 98)), 1.0)))
        bright: UInt8 = np.clip(cut * gain, 0, 255).astype(np.uint8)
        return bright

    def _grown(self, picture: UInt8) -> UInt8:
        how = cv2.INTER_NEAREST if self._scale >= 1 else cv2.INTER_AREA
        grown = cv2.resize(picture, None, fx=self._scale, fy=self._scale, interpolation=how)
        return np.ascontiguousarray(grown, dtype=np.uint8)

    def _enlarged(self, mask: Bool) -> Bool:
        return self._grown(mask[self.rows, self.columns].astype(np.uint8)) > 0
