"""Where a track knows its camera to be, and how it moved: so an object that stands still is not taken for one
that moves because the camera does. Pure values, in the axes of a parent frame that does not move."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.open_region import PreparedSurface
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.motion import increment_velocity

MAX_CAMERA_M_S, MAX_CAMERA_RAD_S = 3.0, 10.0
"""No arm and no hand moves a camera faster. What says so is a jump of the frame that its place is told in."""


@dataclass(frozen=True, eq=False)
class CameraPlace:
    """T_parent_cam (4, 4), told or measured with the frame of `known_ns`; None where it never was. moved:
    from the axes of the camera one frame before to those of now (4, 4), and the seconds between; None where
    that is not known. Velocities are those of objects in the parent frame where it is known, else relative to
    the camera."""

    T_parent_cam: Float64 | None = None
    known_ns: int = 0
    moved: tuple[Float64, float] | None = None

    def at(self, frame: RgbdFrame) -> CameraPlace:
        """The camera's place is that of a frame, and velocities mean what they did."""
        return replace(self, T_parent_cam=frame.T_parent_cam, known_ns=frame.stamp_ns)

    def after(self, frame: RgbdFrame, looked_ns: int) -> tuple[CameraPlace, Float64 | None]:
        """The place in the next frame, and the transform from the camera's axes at the last known place to
        those of now (4, 4), None if unknown. Velocities need the place in the frame just before, which is
        that of `looked_ns`."""
        seconds = (frame.stamp_ns - self.known_ns) * 1e-9
        T_new_old = _moved(self.T_parent_cam, frame.T_parent_cam, seconds)
        moved = None if T_new_old is None or self.known_ns != looked_ns else (T_new_old, seconds)
        known = self if frame.T_parent_cam is None else self.at(frame)
        return replace(known, moved=moved), T_new_old

    def relative(self, surface: PreparedSurface, h: Hypothesis) -> Hypothesis:
        """A hypothesis with its velocity relative to the camera."""
        if self.moved is None or h.velocity is None:
            return h
        T_new_old, seconds = self.moved
        stood = se3.compose(se3.inverse(T_new_old), h.T_cam_obj)
        return replace(h, velocity=h.velocity + increment_velocity(surface, stood, h.T_cam_obj, seconds))


def _moved(T_parent_before: Float64 | None, T_parent_now: Float64 | None, seconds: float) -> Float64 | None:
    """From a camera's axes that many seconds ago to those of now (4, 4); None where that is not known."""
    if T_parent_before is None or T_parent_now is None:
        return None
    T = se3.compose(se3.inverse(T_parent_now), T_parent_before)
    slow = np.linalg.norm(T[:3, 3]) <= MAX_CAMERA_M_S * seconds
    return T if slow and se3.rotation_angle(T, np.eye(4)) <= MAX_CAMERA_RAD_S * seconds else None
