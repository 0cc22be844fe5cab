"""What makes a pile harder than a heap: an open box around it, and what depth cameras do in bad light."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry import Mesh
from huepose.geometry.arrays import Float32, UInt8
from huepose.scenes import prints
from huepose.scenes.charts import blocks
from huepose.scenes.prints import Palette, Rng
from huepose.scenes.sensor import patches
from huepose.scenes.shapes import printed

DARK, GLARE = 14.0, 250.0
"""Grey levels under and over which a stereo camera finds nothing to match."""

LOST_SHARE = 0.6
"""Of such surfaces, in blobs."""


def open_box(half_side_m: float, height_m: float, rng: Rng) -> Mesh:
    """An open box with walls of 8 mm about the origin, one side up to a fifth longer than the other."""
    x, y = half_side_m * rng.uniform(1.0, 1.2), half_side_m
    z, wall = height_m / 2.0, 0.008
    filled = np.ones((3, 3, 2), bool)
    filled[1, 1, 1] = False
    lattice = [-x - wall, -x, x, x + wall], [-y - wall, -y, y, y + wall], [-z, wall - z, z]
    charts = blocks(*lattice, filled, 0.05)
    return printed(charts, [_plain] * len(charts), prints.palette(rng.uniform(), rng), rng, 256)


def _plain(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    return prints.mixed(p.base, p.dark, 0.15 * prints.clouds(rng, height, width, max(height, width) / 3, 3))


def lost_in_bad_light(depth: Float32, color: UInt8, rng: Rng) -> Float32:
    """Depth (H, W) of which blobs are gone, 0, where the picture (H, W, 3) is too dark or too bright."""
    grey = cv2.GaussianBlur(color.max(2).astype(np.float32), (0, 0), 2.0)
    bad = (grey < DARK) | (grey > GLARE)
    return np.where(bad & (patches(rng, depth.shape, 4.0) < LOST_SHARE), np.float32(0.0), depth)


def shifted(depth: Float32, right_px: int, down_px: int) -> Float32:
    """Depth (H, W) that lies so many pixels off the picture; 0 where nothing is known then."""
    height, width = depth.shape
    move = np.array([[1, 0, right_px], [0, 1, down_px]], np.float64)
    return np.asarray(cv2.warpAffine(depth, move, (width, height), flags=cv2.INTER_NEAREST), np.float32)
