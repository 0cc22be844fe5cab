"""Axis-aligned boxes in pixels: x, y of the top-left corner, width, height (columns, rows)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Bool, Float
from huepose.support.errors import InputError


class Box(NamedTuple):
    """A box in pixels: left x, top y, width w, height h; it covers [x, x + w) by [y, y + h)."""

    x: float
    y: float
    w: float
    h: float

    @property
    def x1(self) -> float:
        """Right edge, exclusive."""
        return self.x + self.w

    @property
    def y1(self) -> float:
        """Bottom edge, exclusive."""
        return self.y + self.h

    @property
    def area(self) -> float:
        """Area in square pixels, never negative."""
        return max(0.0, self.w) * max(0.0, self.h)

    def clipped(self, width: int, height: int) -> Box:
        """The part inside an image; w or h is 0 if there is none."""
        x0, y0 = min(max(self.x, 0.0), width), min(max(self.y, 0.0), height)
        x1, y1 = min(max(self.x1, 0.0), width), min(max(self.y1, 0.0), height)
        return Box(x0, y0, max(0.0, x1 - x0), max(0.0, y1 - y0))

    def grown(self, fraction: float, pixels: float = 0.0) -> Box:
        """Grown on every side by `fraction` of its size and by `pixels`."""
        dx, dy = self.w * fraction + pixels, self.h * fraction + pixels
        return Box(self.x - dx, self.y - dy, self.w + 2 * dx, self.h + 2 * dy)

    def iou(self, other: Box) -> float:
        """Intersection over union."""
        w = min(self.x1, other.x1) - max(self.x, other.x)
        h = min(self.y1, other.y1) - max(self.y, other.y)
        shared = max(0.0, w) * max(0.0, h)
        union = self.area + other.area - shared
        return shared / union if union > 0 else 0.0

    def slices(self, width: int, height: int) -> tuple[slice, slice]:
        """Rows and columns of the pixels that the box touches inside an image of that size."""
        b = self.clipped(width, height)
        return slice(math.floor(b.y), math.ceil(b.y1)), slice(math.floor(b.x), math.ceil(b.x1))

    @staticmethod
    def of_mask(mask: Bool) -> Box | None:
        """Bounds of the true pixels of a mask (H, W); None when it is empty."""
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        if not len(rows):
            return None
        x, y = int(columns[0]), int(rows[0])
        return Box(x, y, int(columns[-1]) - x + 1, int(rows[-1]) - y + 1)

    @staticmethod
    def around(*boxes: Box) -> Box:
        """The smallest box that contains all of these."""
        x, y = min(b.x for b in boxes), min(b.y for b in boxes)
        return Box(x, y, max(b.x1 for b in boxes) - x, max(b.y1 for b in boxes) - y)

    @staticmethod
    def of_pixels(pixels: Float) -> Box:
        """Bounds of pixels (N, 2), half a pixel wider on each side so that a single pixel has size 1."""
        lo, hi = np.nanmin(pixels, 0) - 0.5, np.nanmax(pixels, 0) + 0.5
        return Box(float(lo[0]) + 0.5, float(lo[1]) + 0.5, float(hi[0] - lo[0]), float(hi[1] - lo[1]))


def given_box(numbers: Sequence[float], size: tuple[int, int] | None = None) -> Box:
    """The box of four numbers that a user gave. size: width and height of the image, None if they are not
    known. Raises InputError for a box that is less than a pixel wide or high inside the image."""
    box = Box(*numbers)
    inside = box if size is None else box.clipped(*size)
    if all(map(math.isfinite, box)) and inside.w >= 1.0 and inside.h >= 1.0:
        return box
    least = "at least a pixel large" if size is None else f"and in the image of {size[0]} x {size[1]}"
    raise InputError(
        "--box",
        found=" ".join(f"{number:g}" for number in numbers),
        expected=f"X Y W H (left, top, width, height) in pixels, {least}",
    )
