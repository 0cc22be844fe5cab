"""Pinhole cameras. Pixel (u, v) = (column, row); integer coordinates are pixel centres."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry.arrays import Float, Float64

NEAREST_M = 0.02
"""Nothing is nearer to a camera."""


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a pinhole camera: focal lengths and principal point in pixels, size in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @staticmethod
    def from_matrix(K: Float, width: int, height: int) -> Camera:
        """Camera of a 3x3 matrix."""
        return Camera(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), width, height)

    @property
    def K(self) -> Float64:
        """3x3 intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def cropped(self, x0: int, y0: int, width: int, height: int) -> Camera:
        """The camera of the sub-image whose top-left pixel is (x0, y0)."""
        return replace(self, cx=self.cx - x0, cy=self.cy - y0, width=width, height=height)

    def scaled(self, factor: float) -> Camera:
        """The camera of the image resized by `factor`, pixel areas kept (as cv2.resize does)."""
        return Camera(
            self.fx * factor,
            self.fy * factor,
            (self.cx + 0.5) * factor - 0.5,
            (self.cy + 0.5) * factor - 0.5,
            round(self.width * factor),
            round(self.height * factor),
        )

    def project(self, points_cam: Float) -> Float64:
        """Pixels (..., 2) of camera-frame points (..., 3); points at or behind the camera give nan."""
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
