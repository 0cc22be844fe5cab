"""An open region: a window of a frame in which poses are judged and refined without any mask. The tracker
uses it.

Colours are opponents of single pixels, averaged over the same three lengths on the object as the colours of
the surface samples; light is an offset in them. Coarse averages are computed at lower resolution and
resampled.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import FLOOR_M, NEAR_M, Camera, depth_noise_m
from huepose.geometry.frame import RgbdFrame
from huepose.judge.region import SATURATED, RegionArrays
from huepose.model.types import COLOR_SCALES_M

SCALES_M = (*COLOR_SCALES_M, 0.008)
"""Gaussian sigmas of the three averages on the object; the first two come with a model's surface."""

MIN_SIDE = 16
"""A window with a shorter side, in pixels, shows too little to be judged."""

REACH_SIGMAS = 2.0
"""Gaussians are cut off at this many sigmas: 4 % of the weight lies beyond."""

BLIND = 0.3
"""Weight of a sample's colour where there is no depth reading that shows whether the object is in front."""

_NOWHERE = np.array([-2.0, -2.0, -1.0, -1.0])
_NO_POINTS, _NO_WEIGHTS, _NO_LIGHT = np.zeros((0, 3)), np.zeros(0), np.zeros(3)


@dataclass(frozen=True, eq=False)
class OpenRegion:
    """arrays: input of the kernels, colours (3, h, w, 3) at SCALES_M; (x0, y0): top-left pixel of the window
    in the frame."""

    arrays: RegionArrays
    camera: Camera
    x0: int
    y0: int

    def lit(self, light: Float64 | None) -> OpenRegion:
        """A copy with known light (3,), in opponents, or with unknown light (None)."""
        known = light is not None
        arrays = self.arrays._replace(light=_NO_LIGHT if light is None else light, lit=known)
        return OpenRegion(arrays, self.camera, self.x0, self.y0)

    def blunt(self) -> RegionArrays:
        """The arrays with the two coarser colour scales in place of the two finer ones: wider basins of
        convergence."""
        return self.arrays._replace(finest=1)


def window(box: Box, width: int, height: int) -> tuple[int, int, int, int] | None:
    """The window (x0, y0, width, height) of a box in an image of that size, sides in multiples of four
    pixels; None if a side is under 16 pixels."""
    rows, columns = box.slices(width, height)
    w, h = (columns.stop - columns.start) // 4 * 4, (rows.stop - rows.start) // 4 * 4
    return None if w < MIN_SIDE or h < MIN_SIDE else (columns.start, rows.start, w, h)


def open_region(frame: RgbdFrame, box: Box, distance_m: float, diameter_m: float) -> OpenRegion | None:
    """Cut `box` out of a frame for an object of that diameter at that distance, metres; None where (almost)
    none of the box is in the image."""
    cut = window(box, frame.camera.width, frame.camera.height)
    if cut is None:
        return None
    x0, y0, w, h = cut
    color = np.ascontiguousarray(frame.color[y0 : y0 + h, x0 : x0 + w])
    depth = np.ascontiguousarray(frame.depth[y0 : y0 + h, x0 : x0 + w])
    if not np.isfinite(depth).all():
        depth = np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0)
    saturated = np.asarray(cv2.inRange(color, (0, 0, 0), (SATURATED - 1,) * 3) == 0)
    px_per_m = (frame.camera.fx + frame.camera.fy) / 2.0 / max(distance_m, NEAR_M)
    camera = frame.camera.cropped(x0, y0, w, h)
    # Whole numbers would have every kernel compiled once more.
    fx, fy, cx, cy = (float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    arrays = RegionArrays(
        _NO_POINTS,
        _NO_WEIGHTS,
        0.0,
        depth,
        np.zeros((h, w), np.float32),
        _averaged(opponents_of_bytes(color), px_per_m),
        saturated,
        fx,
        fy,
        cx,
        cy,
        _NOWHERE,
        tolerance_m(diameter_m, distance_m),
        0,
        _NO_LIGHT,
        False,
        BLIND,
    )
    return OpenRegion(arrays, camera, x0, y0)


def tolerance_m(diameter_m: float, distance_m: float) -> float:
    """Tolerance of depth, metres: a reading within it supports the surface. 6 to 12 mm by the object's size,
    and two standard errors of the reading."""
    return max(0.006, min(0.012, 0.05 * diameter_m)) + 2.0 * (depth_noise_m(distance_m) - FLOOR_M)


def _averaged(plain: Float32, px_per_m: float) -> Float32:
    """Opponents (3, h, w, 3) averaged over SCALES_M; each scale at a half of the resolution of the one
    before."""
    height, width = plain.shape[:2]
    averages, image = np.empty((len(SCALES_M), height, width, 3), np.float32), plain
    for out, scale_m, step in zip(averages, SCALES_M, (1, 2, 4), strict=True):
        if step > 1:
            size = (width // step, height // step)
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)
        # About half a sample of blur is there already, from the lens and from averaging areas.
        sigma = float(np.sqrt(max((scale_m * px_per_m / step) ** 2 - 0.25, 0.16)))
        side = 2 * int(np.ceil(REACH_SIGMAS * sigma)) + 1
        if step == 1:
            cv2.GaussianBlur(image, (side, side), sigma, dst=out)
        else:
            cv2.resize(cv2.GaussianBlur(image, (side, side), sigma), (width, height), dst=out)
    return averages
