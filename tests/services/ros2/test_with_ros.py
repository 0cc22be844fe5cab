"""Messages for ROS 2, read and written by ROS 2 itself. `make setup` does not install it; this does:

    $(find .tools -name uv -type f | head -n 1) pip install --python .venv/bin/python \
        ros-jazzy-rclpy ros-jazzy-rmw-fastrtps-cpp ros-jazzy-geometry-msgs ros-jazzy-sensor-msgs
"""

from __future__ import annotations

import json
import sys
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from huepose_protos.examples import example
from huepose_protos.messages import CameraMessage, PoseMessage
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


def examples() -> dict[str, Any]:
    pose, camera = example(PoseMessage), example(CameraMessage)
    return {
        POSE: pose_stamped(pose),
        CAMERA: camera_info(camera, camera.publish_ns),
        TRANSFORM: transforms([pose], None).transforms[0],
    }


def read_by_ros(kind: str, payload: bytes) -> Any:
    package, _, name = kind.split("/")
    return serialization.deserialize_message(payload, getattr(import_module(f"{package}.msg"), name))


def values(message: Any) -> Any:
    """A message of rosbags or of ROS 2 as nested lists of numbers and strings."""
    if hasattr(message, "get_fields_and_field_types"):
        return [values(getattr(message, name)) for name in message.get_fields_and_field_types()]
    if is_dataclass(message):
        names = [field.name for field in fields(message) if field.name != "__msgtype__"]
        return [values(getattr(message, name)) for name in names]
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
