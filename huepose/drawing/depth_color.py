"""Depth, errors and other scalar fields as colours."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Float, UInt8


def depth_to_color(depth: Float) -> UInt8:
    """Picture (H, W, 3) uint8 RGB of depth (H, W) metres. Pixels without a reading are black; the colours
    go from blue at the 1st percentile of the readings to red at the 99th."""
    known = np.asarray(depth) > 0
    if not known.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    low, high = float(np.percentile(depth[known], 1)), float(np.percentile(depth[known], 99))
    return np.where(known[..., None], heat(depth, low, high), 0).astype(np.uint8)


def heat(values: Float, low: float, high: float) -> UInt8:
    """Picture (H, W, 3) uint8 RGB of values (H, W): `low` and less dark blue, `high` and more dark red."""
    share = np.clip((np.asarray(values, np.float64) - low) / max(high - low, 1e-12), 0.0, 1.0)
    grey = np.rint(share * 255).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)[..., ::-1]).astype(np.uint8)
