"""How far the image shifts from frame to frame, by phase correlation of thumbnails, and whether that is
fast."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.frame import RgbdFrame

WIDTH_PX, FAST = 80, 1 / 160
"""Width of a thumbnail. A camera moves fast if its image, or three quarters of it, shift by more than FAST, a
share of the width, from frame to frame: 4 of 640 pixels, some 10 degrees per second at 30 Hz. Three films of
a camera on a hand (`studies.on_hand`) shift by 8 to 13 pixels in the median, the built-in scene by 3.3 at
most. Quarters show that a camera rolls or moves forwards; an object before a static camera seldom moves three
of them (never in 286 frames of fast objects and of a real video)."""


def thumbnail(frame: RgbdFrame) -> Float32:
    """A small grey image (h, w) of a frame."""
    size = WIDTH_PX, max(4, round(WIDTH_PX * frame.camera.height / frame.camera.width))
    small = cv2.resize(frame.color, size, interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), np.float32)


def image_shift(before: Float32, now: Float32) -> Float64:
    """Shift (2,) from one thumbnail (h, w), or a part of it, to the next of the same camera, right and down,
    as shares of the image's width; zero if the two have nothing in common. OpenCV may fade both in place."""
    height, width = before.shape
    shift, alike = cv2.phaseCorrelate(before, now, _fading(width, height))
    return np.array(shift) / WIDTH_PX if alike > 0.0 else np.zeros(2)


def quarters_shift(before: Float32, now: Float32) -> bool:
    """Whether three quarters of the image shift by more than FAST from one thumbnail (h, w) to the next."""
    height, width = before.shape
    quarters = [
        np.s_[y : y + height // 2, x : x + width // 2] for y in (0, height // 2) for x in (0, width // 2)
    ]
    return sum(bool(np.hypot(*image_shift(before[q].copy(), now[q].copy())) > FAST) for q in quarters) >= 3


@cache
def _fading(width: int, height: int) -> Float32:
    """Weights (h, w) that fall to zero at the border: phase correlation takes images for periodic."""
    return np.asarray(cv2.createHanningWindow((width, height), cv2.CV_32F), np.float32)
