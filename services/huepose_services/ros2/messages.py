"""Convert poses, transforms, detections and camera data to messages of ROS 2 in CDR; and read transforms
from CDR.

The types are those of ROS 2 Jazzy; vision_msgs (4.1) is not among its core packages, so its types are
defined here. rosbags serialises and reads the messages, and computes the hashes of the types.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from huepose.geometry.arrays import Float64
from huepose_protos import WireError
from huepose_protos.messages import CameraMessage, Mount, PoseMessage
from huepose_protos.motion import mount_of, rotation_matrix
from huepose_services.runtime.clock import SECOND
from huepose_services.runtime.config_parts import ros_token

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
DETECTIONS = "vision_msgs/msg/Detection3DArray"
CAMERA = "sensor_msgs/msg/CameraInfo"

VISION_MSGS = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\nstring id\n",
    DETECTIONS: "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}


@cache
def types() -> Typestore:
    """The type store with all types that are used."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in VISION_MSGS.items():
        store.register(get_types_from_msg(text, name))
    return store


def type_hash(name: str) -> str:
    """The hash of a type, as `RIHS01_...` (REP 2016)."""
    return str(types().hash_rihs01(name))


def cdr(message: Any) -> bytes:
    """A message in CDR: little-endian, after the four bytes of the encapsulation header."""
    return bytes(types().serialize_cdr(message, message.__msgtype__))


def instance_of(pose: PoseMessage) -> str:
    """The instance of a pose as OBJECT_INSTANCE."""
    return f"{pose.object}_{pose.instance}"


def pose_topic(pose: PoseMessage) -> str:
    """The topic of the poses of an instance, within the namespace."""
    return f"{ros_token(instance_of(pose), 'object')}/pose"


def pose_stamped(pose: PoseMessage) -> Any:
    """geometry_msgs/PoseStamped in the camera's optical frame; the message must have a pose."""
    return types().types[POSE](_header(pose), _pose(pose))


def transforms(poses: Sequence[PoseMessage], camera: CameraMessage | None, prefix: str = "") -> Any:
    """tf2_msgs/TFMessage: the pose of each object in the camera's frame, with the name OBJECT_INSTANCE
    after the prefix; and the pose of the camera in the parent frame of its mount, if it is known. For a
    moving camera it is in a message without objects, with its own timestamp."""
    out, newest = [], None
    for newest in poses:
        out.append(_transform(_header(newest), prefix + instance_of(newest), newest))
    mount = None if camera is None else camera.mount
    if camera is not None and mount is not None and (newest is None or camera.mount_ns is None):
        stamp_ns = newest.capture_ns if newest else camera.mount_ns or camera.publish_ns
        stamped = header(stamp_ns + camera.clock.realtime_offset_ns, mount.parent)
        out.append(_transform(stamped, camera.frame, mount))
    return types().types[TRANSFORMS](out)


def _transform(stamped: Any, child: str, place: PoseMessage | Mount) -> Any:
    make = types().types
    move = make["geometry_msgs/msg/Transform"](_vector(place.translation), _quaternion(place.quaternion))
    return make["geometry_msgs/msg/TransformStamped"](stamped, child, move)


_UNIT = 0.01
"""The length of a quaternion may differ from 1 by this much, as in tf2."""
_MOST_BYTES = 1024 * 1024


def transforms_in(payload: bytes, refuse: Callable[[WireError], None]) -> list[tuple[int, str, Mount]]:
    """The transforms of a tf2_msgs/TFMessage in CDR: Unix time in ns, the child frame, and its pose in its
    parent. refuse: called for bytes that are no such message, and for each transform that is no rigid
    motion; these are left out."""
    if len(payload) > _MOST_BYTES:
        refuse(WireError(f"{len(payload)} bytes of transforms"))
        return []
    try:
        message: Any = types().deserialize_cdr(payload, TRANSFORMS)
    except Exception as error:  # the parser of rosbags raises errors of any type
        refuse(WireError(f"no {TRANSFORMS}: {type(error).__name__} {str(error)[:200]}"))
        return []
    return [read for one in message.transforms if (read := _transform_in(one, refuse)) is not None]


def _transform_in(one: Any, refuse: Callable[[WireError], None]) -> tuple[int, str, Mount] | None:
    t, q = one.transform.translation, one.transform.rotation
    quaternion = np.array([q.x, q.y, q.z, q.w])
    parent, child = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
    if not abs(np.linalg.norm(quaternion) - 1.0) <= _UNIT:
        refuse(WireError(f"the transform of {child[:64]!r} has no valid rotation: {quaternion.tolist()}"))
        return None
    try:
        place = mount_of(parent, np.array([t.x, t.y, t.z]), quaternion)
    except ValueError as error:
        refuse(WireError(f"the transform of {child[:64]!r} in {parent[:64]!r}: {error}"))
        return None
    return one.header.stamp.sec * SECOND + one.header.stamp.nanosec, child, place


def detections(poses: Sequence[PoseMessage], bounds: Mapping[str, Float64]) -> Any:
    """vision_msgs/Detection3DArray of one or more poses of one frame; the score is the quality.

    bounds: by object, its least and greatest coordinates (2, 3), metres."""
    make = types().types
    found = []
    for pose in poses:
        covariance = np.zeros(36) if pose.covariance is None else np.array(pose.covariance)
        where = _pose(pose)
        hypothesis = make["vision_msgs/msg/ObjectHypothesis"](pose.object, pose.quality)
        spread = make["geometry_msgs/msg/PoseWithCovariance"](where, covariance)
        result = make["vision_msgs/msg/ObjectHypothesisWithPose"](hypothesis, spread)
        low, high = bounds.get(pose.object, np.zeros((2, 3)))
        R_cam_obj = rotation_matrix(np.array(pose.quaternion))
        middle = np.array(pose.translation) + R_cam_obj @ (0.5 * (low + high))
        at = make["geometry_msgs/msg/Pose"](make["geometry_msgs/msg/Point"](*middle), where.orientation)
        box = make["vision_msgs/msg/BoundingBox3D"](at, _vector(high - low))
        found.append(make["vision_msgs/msg/Detection3D"](_header(pose), [result], box, instance_of(pose)))
    return make[DETECTIONS](_header(poses[0]), found)


def camera_info(camera: CameraMessage, stamp_ns: int) -> Any:
    """sensor_msgs/CameraInfo of a rectified camera. stamp_ns: timestamp on its clock."""
    make, k = types().types, camera.intrinsics
    K = np.array([k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0])
    P = np.array([k.fx, 0.0, k.cx, 0.0, 0.0, k.fy, k.cy, 0.0, 0.0, 0.0, 1.0, 0.0])
    region = make["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    stamped = header(stamp_ns + camera.clock.realtime_offset_ns, camera.frame)
    return make[CAMERA](
        stamped, k.height, k.width, "plumb_bob", np.zeros(5), K, np.eye(3).ravel(), P, 0, 0, region
    )


def header(unix_ns: int, frame: str) -> Any:
    """std_msgs/Header."""
    make = types().types
    stamp = make["builtin_interfaces/msg/Time"](unix_ns // SECOND, unix_ns % SECOND)
    return make["std_msgs/msg/Header"](stamp, frame)


def _header(pose: PoseMessage) -> Any:
    return header(pose.capture_ns + pose.realtime_offset_ns, pose.frame)


def _pose(pose: PoseMessage) -> Any:
    point = types().types["geometry_msgs/msg/Point"](*_there(pose.translation))
    return types().types["geometry_msgs/msg/Pose"](point, _quaternion(pose.quaternion))


def _vector(xyz: Iterable[float] | None) -> Any:
    return types().types["geometry_msgs/msg/Vector3"](*_there(xyz))


def _quaternion(xyzw: Iterable[float] | None) -> Any:
    return types().types["geometry_msgs/msg/Quaternion"](*_there(xyzw))


def _there(values: Iterable[float] | None) -> Iterable[float]:
    assert values is not None  # the caller gives only messages with a pose
    return values
