"""Pinhole cameras, and the noise model of depth, from which gates, tolerances and covariances follow.
Pixel (u, v) = (column, row); integer coordinates are pixel centres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float64, UInt16
from huepose.support.errors import InputError

NEAREST_M = 0.02
"""No object is nearer to a camera than this, metres."""

NEAR_M = 0.05
"""Surfaces nearer than this, metres, are neither rendered nor judged: the image shows too little of
them."""


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a pinhole camera: focal lengths and principal point in pixels, size in pixels.

    Raises InputError if a focal length is not positive or a number is not finite."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        # Kernels are compiled for one type of number; drivers and files give others.
        if {type(self.fx), type(self.fy), type(self.cx), type(self.cy)} != {float}:
            for name in ("fx", "fy", "cx", "cy"):
                object.__setattr__(self, name, float(getattr(self, name)))
        if {type(self.width), type(self.height)} != {int}:
            for name in ("width", "height"):
                object.__setattr__(self, name, int(getattr(self, name)))
        finite = math.isfinite(self.fx + self.fy + self.cx + self.cy)
        if not finite or self.fx <= 0.0 or self.fy <= 0.0:
            raise InputError(
                "camera intrinsics",
                found=f"fx {self.fx:g}, fy {self.fy:g}, cx {self.cx:g}, cy {self.cy:g}",
                expected="focal lengths over 0 and a principal point, in pixels",
                fix="Take them from the camera's driver or calibration file.",
            )

    @staticmethod
    def from_matrix(K: Float, width: int, height: int) -> Camera:
        """Camera of a 3x3 matrix."""
        return Camera(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), width, height)

    @property
    def K(self) -> Float64:
        """3x3 intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def lens(self) -> Float64:
        """fx, fy, cx, cy (4,), as kernels take them."""
        return np.array([self.fx, self.fy, self.cx, self.cy], np.float64)

    def cropped(self, x0: int, y0: int, width: int, height: int) -> Camera:
        """The camera of the sub-image whose top-left pixel is (x0, y0)."""
        return Camera(self.fx, self.fy, self.cx - x0, self.cy - y0, width, height)

    def scaled(self, factor: float) -> Camera:
        """The camera of the image resized by `factor` as cv2.resize does; the size is rounded to whole
        pixels, at least one."""
        width, height = max(1, round(self.width * factor)), max(1, round(self.height * factor))
        x, y = width / self.width, height / self.height
        cx, cy = (self.cx + 0.5) * x - 0.5, (self.cy + 0.5) * y - 0.5
        return Camera(self.fx * x, self.fy * y, cx, cy, width, height)

    def project(self, points_cam: Float) -> Float64:
        """Pixels (..., 2) of camera-frame points (..., 3); nan for points at or behind the camera."""
        p = np.asarray(points_cam, dtype=np.float64)
        z = np.where(p[..., 2] > 1e-9, p[..., 2], np.nan)
        return np.stack([p[..., 0] / z * self.fx + self.cx, p[..., 1] / z * self.fy + self.cy], -1)

    def rays(self, pixels: Float) -> Float64:
        """Viewing rays (..., 3) with z = 1 of pixels (..., 2)."""
        p = np.asarray(pixels, dtype=np.float64)
        x, y = (p[..., 0] - self.cx) / self.fx, (p[..., 1] - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], -1)

    def backproject(self, pixels: Float, depth: Float) -> Float64:
        """Camera-frame points (..., 3) of pixels (..., 2) at depths (...) in metres."""
        return np.asarray(self.rays(pixels) * np.asarray(depth, dtype=np.float64)[..., None])


STEREO_NOISE_PER_M = 0.0027
"""RMS depth error of an active stereo camera of the D435 class is this times the square of the distance
(metres): subpixel error 0.08 px over focal length 600 px times baseline 5 cm."""

FLOOR_M = 0.0005
"""RMS error that does not depend on the distance, metres: of better sensors, calibration and scanned
models."""

POINTS_PER_READING = 6.0
"""So many points of an object count as one measurement: stereo matches windows, so the errors of
neighbouring pixels are correlated."""


def whole_steps(depth: Float, end: int = 1 << 16) -> UInt16:
    """Depth (H, W), given in steps, rounded to whole steps; 0 where there is no reading, or `end` steps or
    more.

    >>> whole_steps(np.array([0.0, 0.5, np.nan, 9.0], np.float32) / 0.0001).tolist()
    [0, 5000, 0, 0]
    """
    steps = np.asarray(np.rint(depth))
    if not (steps.min() >= 0 and steps.max() < end):  # out of range or nan
        steps = np.where((steps >= 0) & (steps < end), steps, 0)
    return steps.astype(np.uint16)


def depth_noise_m(distance_m: float) -> float:
    """RMS error of a depth reading at a distance, metres.

    >>> round(1000 * depth_noise_m(0.7), 2)
    1.82
    """
    return FLOOR_M + STEREO_NOISE_PER_M * distance_m**2
