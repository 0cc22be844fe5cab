"""Depth whose readings stand apart, as where that of a smaller picture was registered into a larger one: the
holes between them are filled."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from huepose.geometry.frame import RgbdFrame

WHOLE = 0.5
"""A smaller share of all readings that lie in squares of 3 x 3 pixels without a hole: no surface is whole."""

_SQUARE = np.ones((3, 3), np.uint8)


def filled(frame: RgbdFrame) -> RgbdFrame:
    """A frame with the nearest reading beside them in the holes of one or two pixels, where these are nearly
    everywhere; any other as it is."""
    read = (frame.depth > 0.0).view(np.uint8)
    whole = cv2.morphologyEx(read, cv2.MORPH_OPEN, _SQUARE)
    if cv2.countNonZero(whole) >= WHOLE * cv2.countNonZero(read):
        return frame
    holes = cv2.morphologyEx(read, cv2.MORPH_CLOSE, _SQUARE) > read
    nearest = cv2.erode(np.where(read > 0, frame.depth, np.float32(np.inf)), _SQUARE)
    return replace(frame, depth=np.where(holes, nearest, frame.depth))
