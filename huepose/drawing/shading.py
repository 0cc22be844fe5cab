"""Light shading of a rendered image, so that the shape of an object without texture is visible."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, UInt8

_DARKEST, _BEHIND = 0.45, 0.6
"""Share of its colour that a surface keeps: when it faces away from the light; just behind the edge of a
step."""
_LIGHT = np.array([-0.35, -0.45, -0.82])
"""Direction to the light in the camera's frame: over the left shoulder."""
_REACH_PX = 2


def shaded(color: UInt8, depth: Float32, normals_cam: Float32, pixel_m: float, step_m: float) -> UInt8:
    """An image (H, W, 3), darkened where its surface faces away from the light, and along the far side of
    each step. Surfaces that face the camera, and the background, keep their colour.

    depth (H, W), normals_cam (H, W, 3): as in `rendering.Rendering`; pixel_m: size of a pixel at the
    surface; step_m: least depth of a step."""
    there = depth > 0.0
    facing = np.clip(-normals_cam[..., 2], 0.0, 1.0)
    lit = np.clip(normals_cam @ _LIGHT / -_LIGHT[2], 0.0, 1.0)
    share = _DARKEST + (1.0 - _DARKEST) * lit
    # The depth range of a slanted surface within the window is not a step.
    window = np.ones((2 * _REACH_PX + 1, 2 * _REACH_PX + 1), np.uint8)
    far = np.where(there, depth, np.float32(1e6)).astype(np.float32)
    slope = np.sqrt(1.0 - facing**2) / np.maximum(facing, 0.05)
    rise_m = far - cv2.erode(far, window) - np.sqrt(2.0) * _REACH_PX * pixel_m * slope
    share = np.where(there & (rise_m > step_m), _BEHIND * share, share)
    return np.where(there[..., None], np.rint(color * share[..., None]), color).astype(np.uint8)
