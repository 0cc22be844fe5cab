"""The part of a frame that one object needs, prepared once and read by every step.

Colours are CIELAB as OpenCV keeps it in bytes (L * 2.55, a + 128, b + 128), averaged over the same lengths on
the object as the model's own samples (`surface.SCALES_M`), so that texture and image are compared at equal
sharpness; coarser averages are kept at lower resolution. Bytes are enough: half a unit of rounding is far
below the noise of any camera, and smoothing bytes costs a sixth of smoothing floats.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, UInt8
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.tracking.surface import SCALES_M

SATURATED = 250
"""A channel this bright has lost its colour."""

STEPS = (1, 2, 4)
"""Pixels per sample of the three levels."""

MIN_SIDE = 16


class RegionArrays(NamedTuple):
    """What compiled loops read: depth (H, W) float32 metres, 0 = none; usable (H, W) uint8, 0 where a
    channel is saturated; fine, middle, coarse: Lab bytes at STEPS; the window's intrinsics."""

    depth: Float32
    usable: UInt8
    fine: UInt8
    middle: UInt8
    coarse: UInt8
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, eq=False)
class Region:
    """A window of a frame, its corner at pixel (x0, y0)."""

    arrays: RegionArrays
    camera: Camera
    x0: int
    y0: int


def window(box: Box, width: int, height: int) -> tuple[int, int, int, int] | None:
    """x0, y0, width, height of a box inside an image of that size, in whole multiples of the coarsest step;
    None when less than 16 pixels a side are left."""
    rows, columns = box.slices(width, height)
    step = STEPS[-1]
    w, h = (columns.stop - columns.start) // step * step, (rows.stop - rows.start) // step * step
    return None if w < MIN_SIDE or h < MIN_SIDE else (columns.start, rows.start, w, h)


def prepare(frame: RgbdFrame, box: Box, distance_m: float) -> Region | None:
    """Cut `box` out of a frame for an object at that distance; None where (almost) nothing of it is
    inside."""
    cut = window(box, frame.camera.width, frame.camera.height)
    if cut is None:
        return None
    x0, y0, w, h = cut
    color = frame.color[y0 : y0 + h, x0 : x0 + w]
    depth = np.ascontiguousarray(frame.depth[y0 : y0 + h, x0 : x0 + w])
    if not np.isfinite(depth).all():
        depth = np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0)
    lab = cv2.cvtColor(color, cv2.COLOR_RGB2LAB)
    px_per_m = (frame.camera.fx + frame.camera.fy) / 2.0 / max(distance_m, 0.05)
    levels = []
    for scale_m, step in zip(SCALES_M, STEPS, strict=True):
        image = lab if step == 1 else cv2.resize(lab, (w // step, h // step), interpolation=cv2.INTER_AREA)
        # About half a sample of blur is there already, from the lens and from averaging areas.
        sigma = float(np.sqrt(max((scale_m * px_per_m / step) ** 2 - 0.25, 0.16)))
        levels.append(np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.uint8))
    usable = (cv2.inRange(color, (0, 0, 0), (SATURATED,) * 3) > 0).view(np.uint8)
    camera = frame.camera.cropped(x0, y0, w, h)
    # Whole numbers would have every kernel compiled once more.
    fx, fy, cx, cy = (float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    arrays = RegionArrays(depth, usable, levels[0], levels[1], levels[2], fx, fy, cx, cy)
    return Region(arrays, camera, x0, y0)
