"""The camera pose that a track knows, and the camera's motion: so a moving camera does not make an object at
rest look like a moving one. Pure values, in the axes of a static parent frame."""

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
"""No arm and no hand moves a camera faster. A faster motion is a jump of the parent frame."""

STATIC = np.eye(4)
"""The motion of a camera that has not moved. It is recognised by identity (`is`)."""


@dataclass(frozen=True, eq=False)
class CameraPlace:
    """T_parent_cam (4, 4): the camera pose, given or measured, of the frame with timestamp `known_ns`; None
    if there was none. moved: transform from the camera axes of the last frame to the present ones (4, 4),
    None if it stood still, and the seconds between; None if not known. Velocities are those of objects in the
    parent frame if `moved` is known, else relative to the camera."""

    T_parent_cam: Float64 | None = None
    known_ns: int = 0
    moved: tuple[Float64 | None, float] | None = None

    def at(self, frame: RgbdFrame) -> CameraPlace:
        """A copy with the camera pose of a frame; `moved` stays."""
        return CameraPlace(frame.T_parent_cam, frame.stamp_ns, self.moved)

    def after(self, frame: RgbdFrame, looked_ns: int) -> tuple[CameraPlace, Float64 | None]:
        """The `CameraPlace` in the next frame, and the transform from the camera axes of the last known pose
        to the present ones (4, 4), None if unknown. Velocities need the camera pose of the frame just before,
        whose timestamp is `looked_ns`."""
        seconds = (frame.stamp_ns - self.known_ns) * 1e-9
        T_new_old = _moved(self.T_parent_cam, frame.T_parent_cam, seconds)
        moved = None
        if T_new_old is not None and self.known_ns == looked_ns:
            moved = None if T_new_old is STATIC else T_new_old, seconds
        known = self if frame.T_parent_cam is None else self.at(frame)
        return CameraPlace(known.T_parent_cam, known.known_ns, moved), T_new_old

    def relative(self, surface: PreparedSurface, h: Hypothesis) -> Hypothesis:
        """A hypothesis with its velocity relative to the camera."""
        T_new_old, seconds = self.moved or (None, 0.0)
        if T_new_old is None or h.velocity is None:
            return h
        stood = se3.compose(se3.inverse(T_new_old), h.T_cam_obj)
        return replace(h, velocity=h.velocity + increment_velocity(surface, stood, h.T_cam_obj, seconds))


def _moved(T_parent_before: Float64 | None, T_parent_now: Float64 | None, seconds: float) -> Float64 | None:
    """Transform from the camera axes `seconds` ago to the present ones (4, 4); None if not known."""
    if T_parent_before is None or T_parent_now is None:
        return None
    if np.array_equal(T_parent_before, T_parent_now):
        return STATIC
    T = se3.compose(se3.inverse(T_parent_now), T_parent_before)
    slow = se3.length(T[:3, 3]) <= MAX_CAMERA_M_S * seconds
    return T if slow and se3.rotation_angle(T, np.eye(4)) <= MAX_CAMERA_RAD_S * seconds else None
