"""A bare rendering shaded lightly, so that the shape of a plain thing is seen in it."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, UInt8

_DARKEST, _BEHIND = 0.45, 0.6
"""Shares of its colour that a surface keeps: at least, turned away; and just behind the edge of a step."""
_LIGHT = np.array([-0.35, -0.45, -0.82])
"""Towards the light, in the camera's frame: over the left shoulder."""
_REACH_PX = 2


def shaded(color: UInt8, depth: Float32, normals_cam: Float32, pixel_m: float, step_m: float) -> UInt8:
    """A picture (H, W, 3) darker where its surface turns away from the camera and the light, and along the
    far side of each step.

    depth (H, W), normals_cam (H, W, 3): as of `rendering.Rendering`; pixel_m: size of a pixel at the
    surface; step_m: by so much a step is deep at least. What faces the camera keeps its colour, and so does
    what is nothing."""
    there = depth > 0.0
    facing = np.clip(-normals_cam[..., 2], 0.0, 1.0)
    lit = np.clip(normals_cam @ _LIGHT / -_LIGHT[2], 0.0, 1.0)
    share = _DARKEST + (1.0 - _DARKEST) * lit
    # What a slanted surface itself rises in the reach is no step.
    window = np.ones((2 * _REACH_PX + 1, 2 * _REACH_PX + 1), np.uint8)
    far = np.where(there, depth, np.float32(1e6)).astype(np.float32)
    slope = np.sqrt(1.0 - facing**2) / np.maximum(facing, 0.05)
    rise_m = far - cv2.erode(far, window) - np.sqrt(2.0) * _REACH_PX * pixel_m * slope
    share = np.where(there & (rise_m > step_m), _BEHIND * share, share)
    return np.where(there[..., None], np.rint(color * share[..., None]), color).astype(np.uint8)
