"""Convert between messages and the library's values. Fields of the same name are copied, except those that
have another form in messages."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from msgspec import Struct

from huepose.believe.state import State
from huepose.geometry import Box, Camera, RgbdFrame, se3
from huepose.geometry.arrays import Float, Float64, UInt16
from huepose.geometry.camera import whole_steps
from huepose.reinit.types import Prior, Request, RequestedObject
from huepose.support.errors import InputError
from huepose.tracking.types import TrackedPose, Verdict
from huepose_protos import WireError
from huepose_protos.buffers import MAX_PAYLOAD, frame_images
from huepose_protos.fields import BoxXYWH, Quaternion, Vector3
from huepose_protos.messages import FrameHeader, Intrinsics, PerceptionRequest, PoseMessage, TruthMessage
from huepose_protos.messages import Prior as WirePrior
from huepose_protos.messages import RequestedObject as WireRequested
from huepose_protos.motion import rigid
from huepose_services.runtime.clock import now_ns

S = TypeVar("S", bound=Struct)
V = TypeVar("V", bound="_Value")


class _Value(Protocol):
    """A dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


LARGEST_STEP = 65535
"""The largest value of uint16 depth; sensors give it where they have no reading."""

MOST_PIXELS = MAX_PAYLOAD // 5
"""Of an image in a message: each pixel has three bytes of colour and two of depth."""


def check_size(camera: Camera) -> None:
    """Raises InputError for images that are too large for a message."""
    if camera.width * camera.height > MOST_PIXELS:
        raise InputError(
            "image",
            found=f"{camera.width} x {camera.height} pixels",
            expected=f"at most {MOST_PIXELS / 1e6:.1f} million of them",
            fix="Set a smaller mode of the camera, or scale its images, and fx, fy, cx, cy with them.",
        )


def pose_to_wire(T_cam_obj: Float) -> tuple[Vector3, Quaternion]:
    """Translation and quaternion (xyzw) of a pose (4, 4). Raises ValueError if it is no rigid motion."""
    T = rigid(T_cam_obj)
    x, y, z = T[:3, 3].tolist()
    qx, qy, qz, qw = se3.quaternion_from_rotation(T[:3, :3]).tolist()
    return (x, y, z), (qx, qy, qz, qw)


def optional_pose_to_wire(T: Float | None) -> tuple[Vector3, Quaternion] | tuple[None, None]:
    """As `pose_to_wire`; (None, None) without a pose."""
    return (None, None) if T is None else pose_to_wire(T)


def pose_from_wire(translation: Vector3, quaternion: Quaternion) -> Float64:
    """Pose (4, 4) of a translation and a quaternion (xyzw)."""
    return se3.make(se3.rotation_from_quaternion(np.array(quaternion)), np.array(translation))


def optional_pose_from_wire(translation: Vector3 | None, quaternion: Quaternion | None) -> Float64 | None:
    """As `pose_from_wire`; None without a pose."""
    if translation is None or quaternion is None:
        return None
    return pose_from_wire(translation, quaternion)


def box_to_wire(box: Box) -> BoxXYWH:
    """x, y, width, height."""
    return float(box.x), float(box.y), float(box.w), float(box.h)


def pose_of(message: PoseMessage) -> Float64 | None:
    """Pose (4, 4) of a pose message; None if it has none."""
    return optional_pose_from_wire(message.translation, message.quaternion)


def frame_key(message: FrameHeader | PoseMessage | TruthMessage) -> tuple[int, int]:
    """Camera epoch and number of the frame that a message is, or is about."""
    return message.camera_epoch, message.frame_id


def depth_to_wire(depth_m: Float, depth_scale_m: float) -> UInt16:
    """Depth in steps of depth_scale_m; 0 where there is no reading, or a value of LARGEST_STEP or more."""
    return whole_steps(depth_m / depth_scale_m, LARGEST_STEP)


def camera_from_wire(i: Intrinsics) -> Camera:
    """The pinhole camera."""
    return Camera(i.fx, i.fy, i.cx, i.cy, i.width, i.height)


_POSE = pose_to_wire, pose_from_wire
_TWIST = (
    lambda twist: tuple(map(tuple, np.asarray(twist, dtype=np.float64).reshape(2, 3).tolist())),
    lambda linear, angular: np.array([*linear, *angular]),
)
_COVARIANCE = (
    lambda covariance: np.asarray(covariance, dtype=np.float64).ravel().tolist(),
    lambda numbers: np.array(numbers).reshape(6, 6),
)
_BOX = box_to_wire, lambda box: Box(*box)
_FORMS: dict[str, tuple[tuple[str, ...], tuple[Callable[..., Any], Callable[..., Any]]]] = {
    "T_cam_obj": (("translation", "quaternion"), _POSE),
    "prior_T_cam_obj": (("prior_translation", "prior_quaternion"), _POSE),
    "velocity": (("velocity_linear", "velocity_angular"), _TWIST),
    "covariance": (("covariance",), _COVARIANCE),
    "box": (("box",), _BOX),
    "box_visib": (("box",), _BOX),
}
"""Fields that have another form in messages, by the library's name: their fields there, and the functions
to and from them."""
_CALLED = {"epoch": "camera_epoch", "stamp_ns": "capture_ns"}
"""Fields that have another name in messages."""
_WORDS: dict[str, type[Enum]] = {"state": State, "verdict": Verdict}
"""Fields that are a word in messages."""


def to_wire(kind: type[S], value: _Value, **given: Any) -> S:
    """Make a message, or a part of one, from a value of the library: fields of the same name, in the form
    that messages have. given: fields that the value does not have, or that replace its own."""
    out: dict[str, Any] = {}
    for name in value.__dataclass_fields__:
        item = getattr(value, name)
        if name in _FORMS:
            parts, (there, _) = _FORMS[name]
            values = (None,) * len(parts)
            if item is not None:
                values = there(item) if len(parts) > 1 else (there(item),)
            out.update(zip(parts, values, strict=True))
        else:
            out[name] = out[_CALLED.get(name, name)] = item.value if isinstance(item, Enum) else item
    return kind(**{name: item for name, item in {**out, **given}.items() if name in kind.__struct_fields__})


def from_wire(kind: type[V], message: Struct, **given: Any) -> V:
    """Make a value of the library from a message, or from a part of one; null becomes None. given: fields
    that the message does not have, or has in another form."""
    out = dict(given)
    for name in kind.__dataclass_fields__.keys() - given.keys():
        if name in _FORMS:
            parts, (_, back) = _FORMS[name]
            values = [getattr(message, part) for part in parts]
            out[name] = None if None in values else back(*values)
        else:
            called = name if hasattr(message, name) else _CALLED.get(name, name)
            if hasattr(message, called):
                item = getattr(message, called)
                out[name] = _WORDS[name](item) if name in _WORDS else item
    return kind(**out)


def prior_from_wire(prior: WirePrior) -> Prior:
    """A tracked pose that can be predicted to another timestamp."""
    return from_wire(Prior, prior)


def requested_from_wire(asked: WireRequested) -> RequestedObject:
    """The part of a request about one object."""
    prior = None if asked.prior is None else prior_from_wire(asked.prior)
    return from_wire(RequestedObject, asked, prior=prior, others=tuple(map(prior_from_wire, asked.others)))


def _requested_to_wire(asked: RequestedObject) -> WireRequested:
    """The part of a request about one object, for a message."""
    prior = None if asked.prior is None else to_wire(WirePrior, asked.prior)
    return to_wire(WireRequested, asked, prior=prior, others=[to_wire(WirePrior, o) for o in asked.others])


def request_to_wire(request: Request, seq: int) -> PerceptionRequest:
    """The message of a request; seq: its number in the message."""
    objects, waiting = (
        [_requested_to_wire(one) for one in some] for some in (request.objects, request.waiting)
    )
    return to_wire(
        PerceptionRequest,
        request,
        publish_ns=now_ns(),
        seq=seq,
        objects=objects,
        waiting=waiting,
    )


def frame_from_wire(header: FrameHeader, payload: bytes) -> RgbdFrame:
    """The frame of a header and its payload. Raises WireError if they do not fit together, or have values
    that no frame of a camera has."""
    color, depth = frame_images(header, payload)
    try:
        return RgbdFrame(
            color=color,
            depth=depth.astype(np.float32) * np.float32(header.intrinsics.depth_scale_m),
            camera=camera_from_wire(header.intrinsics),
            frame_id=header.frame_id,
            stamp_ns=header.capture_ns,
            epoch=header.camera_epoch,
            T_parent_cam=optional_pose_from_wire(header.camera_translation, header.camera_quaternion),
        )
    except InputError as error:
        raise WireError(str(error)) from None


def tracked_to_wire(
    pose: TrackedPose, header: FrameHeader, publish_ns: int, centre: Float64, reason: str = ""
) -> PoseMessage:
    """The message of a tracked pose; the header gives the coordinate frame and the clock of the camera.
    centre (3,): of the object, in object axes."""
    return to_wire(
        PoseMessage,
        pose,
        publish_ns=publish_ns,
        frame=header.frame,
        clock_id=header.clock.clock_id,
        realtime_offset_ns=header.clock.realtime_offset_ns,
        reason=reason,
        centre=tuple(centre.tolist()),
    )
