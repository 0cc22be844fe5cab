"""Poses for ROS 2: decoded by a library that did not write them, with known keys and tokens."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import pytest
import zenoh
from mcap_ros2._dynamic import generate_dynamic

from huepose_protos import decode, encode
from huepose_protos.examples import example
from huepose_protos.messages import CameraMessage, Mount, PoseMessage
from huepose_protos.motion import pose_at
from huepose_services.following import Follower
from huepose_services.ros2.messages import (
    CAMERA,
    DETECTIONS,
    POSE,
    TRANSFORMS,
    camera_info,
    cdr,
    detections,
    pose_stamped,
    pose_topic,
    transforms,
    type_hash,
    types,
)
from huepose_services.ros2.publisher import attachment, endpoint_token, node_token, topic_key
from huepose_services.ros2.work import Ros2Work, Router
from huepose_services.runtime.config import BusConfig, CameraConfig, Config, Ros2Config
from huepose_services.runtime.config_parts import of_cameras
from tests.services.conftest import until
from tests.services.sessions import close_bus, listening, open_bus

EXAMPLE = example(PoseMessage)
MOUNT = Mount(parent="base_link", translation=(1.0, 2.0, 3.0), quaternion=(0.0, 0.0, 0.5**0.5, 0.5**0.5))
CAMERA_SEEN = msgspec.structs.replace(example(CameraMessage), mount=MOUNT)
# From the documentation of rmw_zenoh.
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def pose(**changes: Any) -> PoseMessage:
    return msgspec.structs.replace(EXAMPLE, **{"state": "TRACKING", **changes})


def unwanted(key: str, found: str, expected: str, fix: str) -> None:
    raise AssertionError(key)


def read(kind: str, payload: bytes) -> Any:
    """CDR decoded by a library that is independent of the one that wrote it."""
    text, _ = types().generate_msgdef(kind, ros_version=2)
    short = kind.replace("/msg/", "/")
    return generate_dynamic(short, text)[short](payload)


def unix_ns(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def test_a_pose_is_decoded_unchanged() -> None:
    back = read(POSE, cdr(pose_stamped(pose())))
    assert unix_ns(back.header) == EXAMPLE.capture_ns + EXAMPLE.realtime_offset_ns
    assert back.header.frame_id == EXAMPLE.frame
    p, q = back.pose.position, back.pose.orientation
    assert (p.x, p.y, p.z) == tuple(EXAMPLE.translation)
    assert (q.x, q.y, q.z, q.w) == tuple(EXAMPLE.quaternion)


def test_the_tree_leads_from_the_robot_to_the_object() -> None:
    shown = pose(object="tea_box", instance=3)
    back = read(TRANSFORMS, cdr(transforms([shown], CAMERA_SEEN))).transforms
    names = [(t.header.frame_id, t.child_frame_id) for t in back]
    assert names == [(EXAMPLE.frame, "tea_box_3"), ("base_link", CAMERA_SEEN.frame)]

    def matrix(transform: Any) -> np.ndarray:
        q, t = transform.rotation, transform.translation
        as_pose = pose(quaternion=(q.x, q.y, q.z, q.w), translation=(t.x, t.y, t.z))
        found = pose_at([as_pose], as_pose.capture_ns)
        assert found is not None
        return found.T_cam_obj

    T_parent_obj = matrix(back[1].transform) @ matrix(back[0].transform)
    found = pose_at([shown], shown.capture_ns)
    assert found is not None
    assert found.T_parent_obj is None
    mounted = type(found)(**{**vars(found), "mount": MOUNT}).T_parent_obj
    assert mounted is not None
    assert np.allclose(T_parent_obj, mounted)
    # A rotation by 90 degrees about z, then the translation: x of the camera is y of the robot.
    x, y, z = EXAMPLE.translation
    assert np.allclose(mounted[:3, 3], [1.0 - y, 2.0 + x, 3.0 + z])


def test_a_frame_has_one_parent_also_if_two_cameras_see_the_object() -> None:
    cameras = [CameraConfig(name="left"), CameraConfig(name="right")]
    children = [
        read(TRANSFORMS, cdr(transforms([pose(object="tea-box")], None, each.ros2.frame_prefix)))
        .transforms[0]
        .child_frame_id
        for each in of_cameras(Config(cameras=cameras), False, unwanted)
    ]
    assert children == [f"{name}/tea-box_{EXAMPLE.instance}" for name in ("left", "right")]


@pytest.mark.parametrize("name", ["tea_box", "tea-box", "003_cracker_box", "0"])
def test_topics_have_names_that_ros_2_accepts(name: str) -> None:
    (config,) = of_cameras(Config(cameras=[CameraConfig(name=name)]), False, unwanted)
    topic = f"/{config.ros2.namespace}/{pose_topic(pose(object=name))}"
    # rmw/validate_full_topic_name.h
    assert re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", topic)
    assert len(topic) <= 247


def test_detections_and_camera_info_are_decoded_unchanged() -> None:
    box = np.array([[-0.05, -0.1, -0.05], [0.05, 0.1, 0.25]])
    upright = pose(quaternion=(0.0, 0.0, 0.0, 1.0))
    (found,) = read(DETECTIONS, cdr(detections([upright], {upright.object: box}))).detections
    assert found.id == f"{upright.object}_{upright.instance}"
    (result,) = found.results
    assert (result.hypothesis.class_id, result.hypothesis.score) == (upright.object, upright.quality)
    assert list(result.pose.covariance) == upright.covariance
    assert found.bbox.center.position.z == pytest.approx(upright.translation[2] + 0.1)
    assert (found.bbox.size.x, found.bbox.size.y, found.bbox.size.z) == pytest.approx((0.1, 0.2, 0.3))
    seen = read(CAMERA, cdr(camera_info(CAMERA_SEEN, CAMERA_SEEN.publish_ns)))
    k = CAMERA_SEEN.intrinsics
    assert (seen.k[0], seen.k[2], seen.k[4], seen.k[5]) == (k.fx, k.cx, k.fy, k.cy)
    assert (seen.width, seen.height, seen.header.frame_id) == (k.width, k.height, CAMERA_SEEN.frame)


def test_keys_and_tokens_are_those_of_rmw_zenoh() -> None:
    kind = "std_msgs/msg/String"
    assert type_hash(kind) == STRING_HASH
    assert (
        topic_key("/chatter", kind, 0, "rmw_zenoh") == f"0/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    )
    assert topic_key("/robot/chatter", kind, 0, "bridge") == "robot/chatter"
    session = "a1" * 16
    assert node_token(2, session, "talker") == f"@ros2_lv/2/{session}/0/0/NN/%/%/talker"
    assert endpoint_token("MP", 2, session, "talker", 10, "/chatter", kind) == (
        f"@ros2_lv/2/{session}/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
        "/::,10:,:,:,,"
    )
    number, at_ns, length, gid = struct.unpack("<qqB16s", attachment(7, 123, "token"))
    assert (number, at_ns, length) == (7, 123, 16)
    assert gid == attachment(8, 9, "token")[-16:] != attachment(7, 123, "other")[-16:]


@dataclass
class Heard:
    samples: list[zenoh.Sample]

    def of(self, part: str) -> list[zenoh.Sample]:
        return [s for s in self.samples if part in str(s.key_expr)]


@pytest.mark.live
def test_tracking_poses_arrive_at_a_router_that_starts_later(base_port: int) -> None:
    connect = f"tcp/127.0.0.1:{base_port + 9}"
    config = Config(bus=BusConfig(base_port=base_port), ros2=Ros2Config(connect=connect))
    bus, tracker = (open_bus(config, worker) for worker in ("ros2", "tracker"))
    work = Ros2Work(bus, Router(config.ros2), config.ros2, {}, Follower(bus, dict, []), None)
    until(lambda: bus.health.message().warnings != [], 20.0, work.step)
    (warning,) = bus.health.message().warnings
    assert f"no router of ROS 2 answers at {config.ros2.connect}; `ros2 run" in warning
    with zenoh.open(listening(connect, mode="router")) as router:
        heard = Heard([])
        router.declare_subscriber("0/**", heard.samples.append)
        shown = pose(frame_id=1)
        suspect = pose(state="SUSPECT", instance=9)

        def arrived() -> bool:
            for message in (shown, suspect):
                tracker.put(config.keys.pose(message.object, message.instance), message)
            tracker.put(config.keys.camera_info, CAMERA_SEEN)
            return bool(heard.of("/detections/")) and bus.health.message().warnings == []

        until(arrived, 20.0, work.step)
        tokens = {str(r.ok.key_expr) for r in router.liveliness().get("@ros2_lv/**") if r.ok is not None}
    close_bus(bus)
    close_bus(tracker)
    name = f"huepose/{pose_topic(shown)}"
    sample = heard.of(name)[0]
    assert str(sample.key_expr) == f"0/{name}/geometry_msgs::msg::dds_::PoseStamped_/{type_hash(POSE)}"
    assert read(POSE, sample.payload.to_bytes()).pose.position.x == shown.translation[0]
    assert sample.attachment is not None
    assert struct.unpack("<q", sample.attachment.to_bytes()[:8]) == (1,)
    assert not heard.of(f"{suspect.object}_9/")
    assert heard.of("0/tf/")
    assert heard.of("/camera_info/")
    assert any("/MP/%/%/huepose/%tf/" in token for token in tokens)
    assert any(token.endswith("/NN/%/%/huepose") for token in tokens)


def test_a_camera_message_has_its_mount_with_a_unit_quaternion() -> None:
    back = decode(encode(CAMERA_SEEN), CameraMessage)
    assert back.mount == MOUNT
    with pytest.raises(ValueError, match="unit length"):
        Mount(parent="base", translation=(0.0, 0.0, 0.0), quaternion=(0.0, 0.0, 0.0, 2.0))
    rounded = Mount(parent="base", translation=(0.0, 0.0, 0.0), quaternion=(-0.88, 0.0, 0.0, 0.47))
    assert np.linalg.norm(rounded.quaternion) == pytest.approx(1.0, abs=1e-12)
    assert rounded.quaternion[0] / rounded.quaternion[3] == pytest.approx(-0.88 / 0.47)
