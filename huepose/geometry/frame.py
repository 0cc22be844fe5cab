"""The RGB-D frame. Every camera source and data set yields it, and every method reads it."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.geometry.camera import Camera
from huepose.support.errors import InputError, require

LEAST_SIDE = 2
"""Fewest pixels of a side of an image; bilinear interpolation needs two."""

FARTHEST_M = 1e8
"""Largest distance of a camera from the origin of its parent frame, metres: ten times that of any map of
the earth."""


@dataclass(frozen=True, eq=False)
class RgbdFrame:
    """One rectified colour image with depth in its pixels.

    color (H, W, 3) uint8 RGB; depth (H, W) float32 metres, 0 where there is no reading (NaN, infinite and
    negative numbers become 0); frame_id counts within a camera epoch; stamp_ns is the capture time on the
    monotonic clock; T_parent_cam (4, 4): the pose of the camera at that time in a static frame, such as a
    robot's base; None if it is not known. Raises InputError if sizes or types do not fit, or if T_parent_cam
    is not a rigid transform.
    """

    color: UInt8
    depth: Float32
    camera: Camera
    frame_id: int = 0
    stamp_ns: int = 0
    epoch: int = 0
    T_parent_cam: Float64 | None = None

    def __post_init__(self) -> None:
        require(self.camera, Camera, "camera", "a Camera", "Make one: Camera(fx, fy, cx, cy, width, height).")
        require(self.color, np.ndarray, "colour image", "a numpy array")
        require(self.depth, np.ndarray, "depth image", "a numpy array", "Every frame needs depth.")
        size = (self.camera.height, self.camera.width)
        if self.color.shape != (*size, 3) or self.color.dtype.name != "uint8":
            fix = "Check that the image and the camera file belong together."
            if self.color.shape == (*size, 4):
                fix = "Leave out the fourth channel: color[..., :3]."
            elif self.color.shape == size:
                fix = "A grey image is not enough: objects are distinguished by their colours."
            elif self.color.shape == (*size, 3):
                fix = "If the values are 0 to 1: (color * 255).astype(np.uint8)."
            raise InputError(
                "colour image",
                found=f"{self.color.shape} {self.color.dtype}",
                expected=f"{(*size, 3)} uint8, the size in the intrinsics",
                fix=fix,
            )
        if self.depth.shape != size or self.depth.dtype != np.float32:
            fix = "Align depth to colour in the camera driver, or check the file."
            if self.depth.shape == size:
                whole = np.issubdtype(self.depth.dtype, np.integer)
                fix = "Integers are usually millimetres: " if whole else ""
                fix += f"depth.astype(np.float32){' * 0.001' if whole else ''}."
            raise InputError(
                "depth image",
                found=f"{self.depth.shape} {self.depth.dtype}",
                expected=f"{size} float32 metres, aligned to the colour image",
                fix=fix,
            )
        if min(size) < LEAST_SIDE:
            raise InputError("image", found=str(size), expected=f"sides of {LEAST_SIDE} pixels or more")
        for name in ("frame_id", "stamp_ns", "epoch"):
            number = getattr(self, name)
            if type(number) is not int:
                fix = "Nanoseconds of a time in seconds: round(seconds * 1e9)." if name == "stamp_ns" else ""
                require(number, int | np.integer, name, "a whole number", fix)
                object.__setattr__(self, name, int(number))
        if self.T_parent_cam is not None:
            # A copy, because the caller may write the next pose into the same array.
            T = np.array(self.T_parent_cam, np.float64)
            if not se3.is_rigid(T, se3.ROUNDED) or np.abs(T[:3, 3]).max() > FARTHEST_M:
                raise InputError(
                    "T_parent_cam, the camera's pose",
                    found=" ".join(str(self.T_parent_cam).split())[:80],
                    expected=f"a rigid transform (4, 4), metres, at most {FARTHEST_M:.0e}",
                    fix="Leave it out if the camera pose is not known.",
                )
            object.__setattr__(self, "T_parent_cam", se3.orthonormalised(T))
        # Kernels are compiled for arrays of one layout; drivers and slices give others.
        if not self.color.flags.c_contiguous:
            object.__setattr__(self, "color", np.ascontiguousarray(self.color))
        if not (self.depth.flags.c_contiguous and self.depth.flags.writeable):
            object.__setattr__(self, "depth", self.depth.copy())
        # Tests all readings without a temporary array.
        if not (self.depth.min() >= 0.0 and np.isfinite(self.depth.max())):
            read = np.isfinite(self.depth) & (self.depth > 0.0)
            known = np.where(read, self.depth, np.float32(0.0))
            object.__setattr__(self, "depth", known)

    def seen_from(self, T_parent_cam: Float64 | None) -> RgbdFrame:
        """The same frame with another camera pose, a rigid transform (4, 4)."""
        other = copy(self)  # skips the checks of __post_init__
        object.__setattr__(other, "T_parent_cam", T_parent_cam)
        return other

    def without(self, pixels: Bool) -> RgbdFrame:
        """The same frame without the depth readings of `pixels` (H, W)."""
        return replace(self, depth=np.where(pixels, np.float32(0.0), self.depth))
