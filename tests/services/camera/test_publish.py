"""Frames of a moving camera contain the camera's pose."""

from __future__ import annotations

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame, se3
from huepose.support.errors import InputError
from huepose_protos.buffers import MAX_PAYLOAD
from huepose_protos.messages import CameraMessage, Mount, MountMessage
from huepose_services.camera.publish import FramePublisher, packed
from huepose_services.convert import MOST_PIXELS, check_size, frame_from_wire
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config_file import load
from tests.services.fake_bus import FakeBus

CAMERA = Camera(20.0, 20.0, 3.5, 2.5, 8, 6)
MS = 1_000_000
T_BASE_CAM = se3.make(se3.rotation_exp(np.array([0.2, -0.1, 0.4])), np.array([0.3, 0.1, 0.9]))


@pytest.fixture
def publisher_of(tmp_path):
    """A function: the publisher of a camera with this configuration, and its bus."""

    def make(**camera):
        path = tmp_path / "pipeline.yaml"
        camera = {"source": "python", "path": "cam.py", **camera}
        path.write_text(json.dumps({"workers": ["camera"], "bundles": "bundles", "camera": camera}))
        bus = FakeBus("camera", load(path).keys)
        bus.inbox.queue = lambda *_, **__: object()
        return FramePublisher(bus, load(path)), bus

    return make


def _mount_arrives(bus, stamp_ns, x_m, angle_rad=0.0):
    quaternion = (0.0, 0.0, float(np.sin(angle_rad / 2)), float(np.cos(angle_rad / 2)))
    mount = Mount(parent="base_link", translation=(x_m, 0.0, 0.5), quaternion=quaternion)
    bus.arriving[MountMessage].append(MountMessage(publish_ns=now_ns(), capture_ns=stamp_ns, mount=mount))


def _published(publisher, bus, stamp_ns, frame_id=0, T_parent_cam=None):
    """Publishes a frame; gives it as a subscriber gets it."""
    color, depth = np.full((6, 8, 3), 90, np.uint8), np.ones((6, 8), np.float32)
    picture = packed(RgbdFrame(color, depth, CAMERA, T_parent_cam=T_parent_cam), 0.0001)
    publisher.publish(picture, 1, frame_id, stamp_ns)
    return frame_from_wire(bus.headers[-1], picture.payload)


def test_a_frame_has_the_camera_pose_of_its_capture_time(publisher_of):
    hand = {"parent": "tool0", "translation": [0.0, 0.1, 0.0], "quaternion": [0.0, 0.0, 0.0, 1.0]}
    publisher, bus = publisher_of(moving=True, mount=hand)
    now = now_ns()
    _mount_arrives(bus, now, 0.2)
    _mount_arrives(bus, now + 20 * MS, 0.3, 0.04)
    T = _published(publisher, bus, now + 5 * MS).T_parent_cam
    # A quarter of the way, and the camera 0.1 m beside the tool.
    rotation = se3.rotation_exp(np.array([0.0, 0.0, 0.01]))
    np.testing.assert_allclose(
        T, se3.make(rotation, np.array([0.225, 0.0, 0.5]) + rotation @ [0.0, 0.1, 0.0]), atol=2e-5
    )
    # The next image is newer than all given poses: the motion is extrapolated.
    T = _published(publisher, bus, now + 40 * MS, 1).T_parent_cam
    np.testing.assert_allclose(T[:3, :3], se3.rotation_exp(np.array([0.0, 0.0, 0.08])), atol=1e-9)
    assert [m.mount_ns for m in bus.said if isinstance(m, CameraMessage)] == [None, now, now + 20 * MS]


def test_a_frame_has_no_camera_pose_if_none_is_given_in_time(publisher_of):
    publisher, bus = publisher_of(moving=True)
    now = now_ns()
    assert _published(publisher, bus, now).T_parent_cam is None
    _mount_arrives(bus, now, 0.2)
    assert _published(publisher, bus, now + 10 * MS, 1).T_parent_cam is None, "one pose gives no motion"
    _mount_arrives(bus, now + 20 * MS, 0.3)
    assert _published(publisher, bus, now + 400 * MS, 2).T_parent_cam is None
    assert _published(publisher, bus, now + 100 * MS, 3, T_BASE_CAM).T_parent_cam[0, 3] == pytest.approx(0.7)


@pytest.mark.parametrize("back_ms", [0, 5000])
def test_a_pose_that_is_seconds_older_begins_anew_and_a_repeated_time_is_ignored(publisher_of, back_ms):
    publisher, bus = publisher_of(moving=True)
    now = now_ns()
    for stamp, x in (
        (now + 5000 * MS, 9.0),
        (now + (5000 - back_ms) * MS, 0.2),
        (now + (5020 - back_ms) * MS, 0.3),
    ):
        _mount_arrives(bus, stamp, x)
    T = _published(publisher, bus, now + (5010 - back_ms) * MS).T_parent_cam
    assert T[0, 3] == pytest.approx(0.25 if back_ms else (9.0 + 0.3) / 2)


def test_a_pose_that_comes_a_little_late_is_ignored(publisher_of):
    publisher, bus = publisher_of(moving=True)
    now = now_ns()
    for stamp, x in ((now, 0.2), (now + 20 * MS, 0.3), (now + 10 * MS, 9.0)):
        _mount_arrives(bus, stamp, x)
    assert _published(publisher, bus, now + 15 * MS).T_parent_cam[0, 3] == pytest.approx(0.275)


def test_a_source_may_give_the_camera_pose_itself(publisher_of):
    publisher, bus = publisher_of()
    np.testing.assert_allclose(
        _published(publisher, bus, now_ns(), 0, T_BASE_CAM).T_parent_cam, T_BASE_CAM, atol=1e-9
    )
    assert _published(publisher, bus, now_ns(), 1).T_parent_cam is None


def test_frames_of_a_fixed_camera_have_no_camera_pose(publisher_of):
    rotation = [0.0, 0.0, 0.0, 1.0]
    publisher, bus = publisher_of(
        mount={"parent": "base_link", "translation": [0.0, 0.0, 1.0], "quaternion": rotation}
    )
    assert _published(publisher, bus, now_ns()).T_parent_cam is None


def test_a_frame_that_is_published_again_has_the_same_header(publisher_of):
    publisher, bus = publisher_of()
    now = now_ns()
    for frame_id in (3, 3, 4):
        _published(publisher, bus, now, frame_id)
    first, again, other = bus.headers
    assert again.publish_ns > first.publish_ns
    assert msgspec.structs.replace(again, publish_ns=first.publish_ns) == first
    assert other.frame_id == 4


def test_the_largest_image_fits_into_a_message():
    assert 5 * MOST_PIXELS <= MAX_PAYLOAD < 5 * (MOST_PIXELS + 1)
    wide = Camera(20.0, 20.0, 3.5, 2.5, MOST_PIXELS // 2, 2)
    check_size(wide)
    with pytest.raises(InputError, match=r"found 6710887 x 2 pixels; expected at most 13\.4 million of them"):
        check_size(replace(wide, width=wide.width + 1))
