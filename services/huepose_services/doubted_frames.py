"""What is wrong with a frame as such, so that no pose in it is to be acted on, however well it fits."""

from __future__ import annotations

import numpy as np

from huepose.geometry import RgbdFrame
from huepose.geometry.picture_faults import LEAST_DEPTH, depth_share

_FEW = 16


def complaint_about(frame: RgbdFrame, before: RgbdFrame | None) -> str | None:
    """The reason to doubt a frame, by itself and beside the one before it; None where there is none."""
    if depth_share(frame.depth) < LEAST_DEPTH:
        return "there is no depth in the whole picture: is the depth camera covered, or its stream off?"
    if before is None or before.epoch != frame.epoch:
        return None
    if before.camera != frame.camera:
        return (
            "the picture's size or intrinsics changed while the camera was open: a camera that is set anew "
            "must begin a new epoch"
        )
    if _equal(before.color, frame.color) and not _equal(before.depth, frame.depth):
        return "the colour picture stands still while depth goes on: is the colour stream stuck?"
    return None


def _equal(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two pictures are the same; a few of their rows tell nearly always that they are not."""
    return np.array_equal(one[::_FEW], other[::_FEW]) and np.array_equal(one, other)
