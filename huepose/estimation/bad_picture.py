"""A frame in which nothing can be found, and why, in one sentence: no depth, depth of another unit, a black
picture, a grey one."""

from __future__ import annotations

import numpy as np

from huepose.geometry.depth_noise import depth_noise_m
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.picture_faults import LEAST_DEPTH, all_dark, all_grey, depth_share, readings

NEAREST_SHARE = 0.05
"""So many readings may be nearer than what a frame shows: specks."""

LARGEST_ERROR = 0.25
"""Where readings err by more than this share of an object's diameter, its shape is not to be seen."""

NEVER_NEARER_M = 0.1
"""No depth camera measures nearer."""


def bad_picture(frame: RgbdFrame, diameter_m: float) -> str | None:
    """What is wrong with a frame in which an object of that diameter is sought; None where nothing is."""
    share = depth_share(frame.depth)
    if share < LEAST_DEPTH:
        return f"The frame has no depth: {100 * share:.1f} % of its pixels have a reading."
    seen = frame.depth[readings(frame.depth)]
    nearest, farthest = (float(x) for x in np.quantile(seen, [NEAREST_SHARE, 1.0 - NEAREST_SHARE]))
    error_m = depth_noise_m(nearest)
    if error_m > LARGEST_ERROR * diameter_m:
        return (
            f"All depth is {nearest:.1f} m away or farther, where readings err by {100 * error_m:.0f} cm and "
            "the object has no shape: is the depth scale right?"
        )
    if farthest < NEVER_NEARER_M:
        return f"All depth is nearer than {farthest:.3f} m, where nothing measures: is the depth scale right?"
    if all_dark(frame.color):
        return "The picture is black: is the lens covered, or the light off?"
    if all_grey(frame.color):
        return "The picture is grey: objects are told by their colours. Is the camera's colour stream read?"
    return None
