"""Messages for ROS 2, read and written by ROS 2 itself. `make setup` does not install it; this does:

    $(find .tools -name uv -type f | head -n 1) pip install --python .venv/bin/python \
        ros-jazzy-rclpy ros-jazzy-rmw-fastrtps-cpp ros-jazzy-geometry-msgs ros-jazzy-sensor-msgs
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from huepose_protos.examples import example
from huepose_protos.messages import CameraMessage, Mount, PoseMessage
from huepose_services.ros2.messages import (
    CAMERA,
    POSE,
    camera_info,
    cdr,
    pose_stamped,
    transforms,
    type_hash,
    types,
)

serialization = pytest.importorskip("rclpy.serialization", reason="ROS 2 is not installed")

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of lark, which ROS 2 imports

SHARE = Path(sys.prefix, "share")
TRANSFORM = "geometry_msgs/msg/TransformStamped"
MOUNT = Mount(parent="base_link", translation=(1.0, 2.0, 3.0), quaternion=(0.0, 0.0, 0.5**0.5, 0.5**0.5))
SEEN = msgspec.structs.replace(example(CameraMessage), mount=MOUNT)


def examples() -> dict[str, Any]:
    return {
        POSE: pose_stamped(example(PoseMessage)),
        CAMERA: camera_info(SEEN, SEEN.publish_ns),
        TRANSFORM: transforms([], SEEN).transforms[0],
    }


def read_by_ros(kind: str, payload: bytes) -> Any:
    package, _, name = kind.split("/")
    module = pytest.importorskip(f"{package}.msg")
    return serialization.deserialize_message(payload, getattr(module, name))


def values(message: Any) -> Any:
    """A message of rosbags or of ROS 2 as nested lists of numbers and strings."""
    if hasattr(message, "get_fields_and_field_types"):
        return [values(getattr(message, name)) for name in message.get_fields_and_field_types()]
    if hasattr(message, "__msgtype__"):
        return [values(getattr(message, name)) for name in message.__dataclass_fields__ if name[0] != "_"]
    return list(message) if hasattr(message, "__len__") and not isinstance(message, str) else message


@pytest.mark.parametrize("kind", [POSE, CAMERA, TRANSFORM])
def test_ros_reads_what_was_written(kind: str) -> None:
    written = examples()[kind]
    assert values(read_by_ros(kind, cdr(written))) == values(written)


@pytest.mark.parametrize("kind", [POSE, CAMERA, TRANSFORM])
def test_what_ros_writes_is_read(kind: str) -> None:
    written = examples()[kind]
    by_ros = bytes(serialization.serialize_message(read_by_ros(kind, cdr(written))))
    assert values(types().deserialize_cdr(by_ros, kind)) == values(written)


@pytest.mark.parametrize("kind", [POSE, CAMERA, TRANSFORM])
def test_hashes_of_types_are_those_of_ros(kind: str) -> None:
    described = json.loads((SHARE / f"{kind}.json").read_text())["type_hashes"]
    assert type_hash(kind) == next(one["hash_string"] for one in described if one["type_name"] == kind)
