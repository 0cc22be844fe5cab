"""Removes lens distortion: colour with bilinear interpolation, depth with the nearest reading.

It is done once, where frames enter the program. Models as in OpenCV: `brown_conrady` (ROS: `plumb_bob`) has
k1 k2 p1 p2 [k3], `rational` (ROS: `rational_polynomial`) has k1 k2 p1 p2 k3 k4 k5 k6. The rectified image has
the same intrinsics and size; outside the original image it is black, with depth 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, Float64, UInt8
from huepose.geometry.camera import Camera
from huepose.support.errors import InputError

COEFFICIENTS = {"none": (0,), "brown_conrady": (4, 5), "rational": (8,)}

_OF_ROS = {"plumb_bob": "brown_conrady", "rational_polynomial": "rational", "": "none"}
"""ROS names of the models of OpenCV."""

_PINHOLES = frozenset({"inverse_brown_conrady", "modified_brown_conrady"})
"""Models of librealsense that are accepted if all coefficients are zero, as its cameras often report: then
they are pinhole cameras. This does not hold for every model: a fisheye image with zero coefficients is
distorted."""


def checked_coefficients(model: str | None, coefficients: Sequence[float] | None, where: object) -> Float64:
    """The coefficients (N,) in OpenCV's order; empty for no distortion. None means no distortion. Raises
    InputError, naming `where`."""
    model, values = _named(model), _values(coefficients)
    if model in _PINHOLES and not values.any():
        return np.empty(0)
    if model not in COEFFICIENTS:
        raise InputError(
            where,
            found=f"distortion_model '{model}'",
            expected="one of " + ", ".join([*COEFFICIENTS, *filter(None, _OF_ROS)]),
            fix="Rectify the images of another lens first (OpenCV: cv2.fisheye; librealsense: "
            "rs2_project_point_to_pixel), and give the intrinsics of the rectified images.",
        )
    if model == "none" and not values.any():
        return np.empty(0)
    if model == "none":
        raise InputError(
            where,
            found=f"distortion {coefficients!r:.60} with distortion_model 'none'",
            expected="distortion_model: " + " or ".join([*COEFFICIENTS][1:]),
        )
    if len(values) not in COEFFICIENTS[model] or not np.isfinite(values).all():
        counts = " or ".join(str(n) for n in COEFFICIENTS[model])
        raise InputError(
            where, found=f"distortion {coefficients!r:.60}", expected=f"{counts} numbers for '{model}'"
        )
    return values if values.any() else np.empty(0)


def _named(model: object) -> str:
    """Our name of a model. librealsense writes `distortion.brown_conrady` or Brown Conrady."""
    if model is None:
        return "none"
    if not isinstance(model, str):
        return f"{model!r:.60}"
    name = model.removeprefix("distortion.").replace(" ", "_").lower()
    return _OF_ROS.get(name, name)


def _values(coefficients: object) -> Float64:
    """Coefficients (N,), empty for None; a single nan if they are not numbers."""
    try:
        return np.asarray([] if coefficients is None else coefficients, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        return np.array([np.nan])


class Rectifier:
    """Rectifies the images of one camera. maps: column and row (H, W each) of the distorted image from which
    each pixel is read; None if there is no distortion."""

    def __init__(self, maps: tuple[Float32, Float32] | None) -> None:
        self._maps = maps

    @staticmethod
    def of(camera: Camera, coefficients: Float64) -> Rectifier:
        """For a camera with the intrinsics of the pinhole camera `camera` and these coefficients (N,)."""
        if not len(coefficients):
            return Rectifier(None)
        size = (camera.width, camera.height)
        columns, rows = cv2.initUndistortRectifyMap(
            camera.K, coefficients, np.eye(3), camera.K, size, cv2.CV_32FC1
        )
        return Rectifier((np.asarray(columns, np.float32), np.asarray(rows, np.float32)))

    def color(self, image: UInt8) -> UInt8:
        """The rectified colour image (H, W, 3). Raises InputError for an image of another size."""
        return np.asarray(self._rectified(image, cv2.INTER_LINEAR), dtype=np.uint8)

    def depth(self, depth: Float32) -> Float32:
        """The rectified depth (H, W): readings are moved, never interpolated. Raises InputError for an image
        of another size."""
        return np.asarray(self._rectified(depth, cv2.INTER_NEAREST), dtype=np.float32)

    def _rectified(self, image: np.ndarray, how: int) -> np.ndarray:
        if self._maps is None:
            return image
        if image.shape[:2] != self._maps[0].shape:
            raise InputError("image", found=str(image.shape[:2]), expected=f"the size {self._maps[0].shape}")
        return cv2.remap(image, *self._maps, how)
