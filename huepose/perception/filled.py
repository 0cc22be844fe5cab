"""Fills the holes in sparse depth, such as depth of a smaller image that was registered to a larger one."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from huepose.geometry.frame import RgbdFrame

WHOLE = 0.5
"""Depth is sparse if less than this share of all readings lies in squares of 3 x 3 pixels without a
hole."""

_SQUARE = np.ones((3, 3), np.uint8)


def filled(frame: RgbdFrame) -> RgbdFrame:
    """A frame with holes of one or two pixels nearly everywhere gets in each of them the nearest reading
    beside it. Any other frame stays as it is."""
    read = (frame.depth > 0.0).view(np.uint8)
    whole = cv2.morphologyEx(read, cv2.MORPH_OPEN, _SQUARE)
    if cv2.countNonZero(whole) >= WHOLE * cv2.countNonZero(read):
        return frame
    holes = cv2.morphologyEx(read, cv2.MORPH_CLOSE, _SQUARE) > read
    nearest = cv2.erode(np.where(read > 0, frame.depth, np.float32(np.inf)), _SQUARE)
    return replace(frame, depth=np.where(holes, nearest, frame.depth))
