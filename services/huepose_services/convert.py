"""Between the wire and the library: poses, priors, masks, frames. The only module that knows both forms."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Box, Camera, RgbdFrame, se3
from huepose.geometry.arrays import Float, Float64, UInt16
from huepose.reinit.types import Prior
from huepose_protos.buffers import frame_images
from huepose_protos.messages import FrameHeader, Intrinsics, PoseMessage
from huepose_protos.messages import Prior as WirePrior

_ROTATION = 1e-2
LARGEST_STEP = 65535
"""Of depth on the wire; what sensors say where they have none."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
BoxTuple = tuple[float, float, float, float]


def pose_to_wire(T_cam_obj: Float) -> tuple[Vector, Quaternion]:
    """Translation and quaternion (xyzw) of a pose (4, 4). Raises ValueError for what is no rotation: a
    quaternion could not show that it was reflected or stretched."""
    R = T_cam_obj[:3, :3]
    if not (np.abs(R @ R.T - np.eye(3)).max() < _ROTATION and np.linalg.det(R) > 0.0):
        raise ValueError("a pose has no rotation in it")
    x, y, z = T_cam_obj[:3, 3].tolist()
    qx, qy, qz, qw = se3.quaternion_from_rotation(T_cam_obj[:3, :3]).tolist()
    return (x, y, z), (qx, qy, qz, qw)


def optional_pose_to_wire(T_cam_obj: Float | None) -> tuple[Vector | None, Quaternion | None]:
    """The same where there may be no pose."""
    return (None, None) if T_cam_obj is None else pose_to_wire(T_cam_obj)


def pose_from_wire(translation: Vector, quaternion: Quaternion) -> Float64:
    """Pose (4, 4) of a translation and a quaternion (xyzw)."""
    return se3.make(se3.rotation_from_quaternion(np.array(quaternion)), np.array(translation))


def optional_pose_from_wire(translation: Vector | None, quaternion: Quaternion | None) -> Float64 | None:
    """The same where there may be no pose."""
    if translation is None or quaternion is None:
        return None
    return pose_from_wire(translation, quaternion)


def twist_to_wire(velocity: Float | None) -> tuple[Vector | None, Vector | None]:
    """Linear and angular velocity of a twist (6,)."""
    if velocity is None:
        return None, None
    vx, vy, vz, wx, wy, wz = np.asarray(velocity, dtype=np.float64).tolist()
    return (vx, vy, vz), (wx, wy, wz)


def twist_from_wire(linear: Vector | None, angular: Vector | None) -> Float64 | None:
    """Twist (6,) of linear and angular velocity."""
    return None if linear is None or angular is None else np.array([*linear, *angular])


def covariance_to_wire(covariance: Float | None) -> list[float] | None:
    """36 numbers of a covariance (6, 6)."""
    return None if covariance is None else np.asarray(covariance, dtype=np.float64).ravel().tolist()


def covariance_from_wire(numbers: list[float] | None) -> Float64 | None:
    """Covariance (6, 6) of 36 numbers."""
    return None if numbers is None else np.array(numbers).reshape(6, 6)


def box_to_wire(box: Box) -> BoxTuple:
    """x, y, width, height."""
    return float(box.x), float(box.y), float(box.w), float(box.h)


def box_from_wire(box: BoxTuple) -> Box:
    """Box of x, y, width, height."""
    return Box(*box)


def pose_of(message: PoseMessage) -> Float64 | None:
    """Pose (4, 4) of a pose message; None where it has none."""
    return optional_pose_from_wire(message.translation, message.quaternion)


def depth_to_wire(depth_m: Float, depth_scale_m: float) -> UInt16:
    """Depth in steps of depth_scale_m; 0 where there is no reading, also from
    LARGEST_STEP on."""
    steps = np.rint(depth_m / depth_scale_m)
    return np.where((steps >= 0) & (steps < LARGEST_STEP), steps, 0).astype(np.uint16)


def intrinsics_to_wire(camera: Camera, depth_scale_m: float) -> Intrinsics:
    """The same pinhole camera, with the unit of its depth."""
    return Intrinsics(
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        width=camera.width,
        height=camera.height,
        depth_scale_m=depth_scale_m,
    )


def camera_from_wire(i: Intrinsics) -> Camera:
    """The pinhole camera."""
    return Camera(i.fx, i.fy, i.cx, i.cy, i.width, i.height)


def prior_from_wire(prior: WirePrior) -> Prior:
    """A tracked pose that can be predicted to another stamp."""
    return Prior(
        T_cam_obj=pose_from_wire(prior.translation, prior.quaternion),
        velocity=twist_from_wire(prior.velocity_linear, prior.velocity_angular),
        covariance=covariance_from_wire(prior.covariance),
        stamp_ns=prior.stamp_ns,
    )


def frame_from_wire(header: FrameHeader, payload: bytes) -> RgbdFrame:
    """The frame of a header and its payload. Raises WireError where they do not fit together."""
    color, depth = frame_images(header, payload)
    return RgbdFrame(
        color=color,
        depth=depth.astype(np.float32) * np.float32(header.intrinsics.depth_scale_m),
        camera=camera_from_wire(header.intrinsics),
        frame_id=header.frame_id,
        stamp_ns=header.capture_ns,
        epoch=header.camera_epoch,
    )
