"""What the worker publishes in ROS 2 about the poses that it gets, with a fake bus and a fake router."""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import pytest

from huepose.model import ReferenceModel
from huepose.model.io import model_path, save_model
from huepose_protos.messages import CameraMessage, ObjectsMessage, PoseMessage
from huepose_services.following import Follower
from huepose_services.ros2 import work as ros2_work
from huepose_services.ros2.messages import DETECTIONS, POSE, TRANSFORMS, types
from huepose_services.ros2.work import MountFromTf, Ros2Work, Router
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config, ObjectConfig, Ros2Config
from huepose_services.runtime.config_perception import TfConfig
from tests.services.fake_bus import FakeBus, listed
from tests.services.ros2.test_ros2 import CAMERA_SEEN, pose


class _Router:
    """Keeps the published messages, decoded, by their type."""

    connected, node = True, None

    def __init__(self) -> None:
        self.published: dict[str, list[Any]] = defaultdict(list)

    def publish(self, topic: str, kind: str, payload: bytes) -> None:
        self.published[kind].append(types().deserialize_cdr(payload, kind))

    def edges(self) -> set[tuple[str, str]]:
        """Parent and child of all transforms."""
        return {
            (t.header.frame_id, t.child_frame_id) for m in self.published[TRANSFORMS] for t in m.transforms
        }


def _work(mount: MountFromTf | None = None) -> tuple[Ros2Work, FakeBus, _Router]:
    bus, router = FakeBus("ros2"), _Router()
    follower = Follower(cast(Bus, bus), lambda name: np.zeros((2, 3)), [])
    work = Ros2Work(cast(Bus, bus), cast(Router, router), Ros2Config(), {}, follower, mount)
    return work, bus, router


def _now(name: str, frame_id: int, **changes: Any) -> PoseMessage:
    return pose(object=name, frame_id=frame_id, publish_ns=now_ns(), **changes)


def test_poses_of_one_frame_that_come_far_apart_are_one_array(monkeypatch: pytest.MonkeyPatch) -> None:
    at = [now_ns()]
    monkeypatch.setattr(ros2_work, "now_ns", lambda: at[0])
    work, bus, router = _work()
    for frame in (1, 2, 3):
        for name in ("box", "can"):
            bus.arriving[PoseMessage].append(_now(name, frame))
            work.step()
            at[0] += 15_000_000
            work.step()
    assert [len(published.detections) for published in router.published[DETECTIONS]] == [2, 2, 2]
    # A single pose is published without waiting for the others.
    bus.arriving[PoseMessage].append(_now("box", 4))
    work.step()
    assert (len(router.published[POSE]), len(router.published[DETECTIONS])) == (7, 3)
    assert 0 < work.due_ns() - at[0] <= 25_000_000


@pytest.mark.parametrize("theirs", [True, False])
def test_a_frame_whose_transform_the_robot_publishes_gets_no_second_parent(theirs: bool) -> None:
    child = CAMERA_SEEN.frame if theirs else "tool0"
    mount = MountFromTf(cast(Bus, FakeBus("ros2")), TfConfig(parent="base_link", child=child))
    work, bus, router = _work(mount=mount)
    moving = msgspec.structs.replace(CAMERA_SEEN, mount_ns=now_ns())
    bus.arriving[CameraMessage] += [moving, moving]
    work.step()
    for frame in (1, 2):
        bus.arriving[PoseMessage].append(_now("box", frame))
        work.step()
    assert (CAMERA_SEEN.frame, f"box_{pose().instance}") in router.edges()
    assert (("base_link", CAMERA_SEEN.frame) in router.edges()) is not theirs
    assert all(message.transforms for message in router.published[TRANSFORMS])


def test_an_object_that_is_added_later_has_its_box(
    tea_box: ReferenceModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("can", "tea_box"):
        save_model(replace(tea_box, name=name), model_path(tmp_path, name))
    monkeypatch.setattr(ros2_work, "Router", lambda ros2: _Router())
    bus = FakeBus("ros2")
    work = ros2_work.make(cast(Bus, bus), Config(bundles=str(tmp_path), objects=[ObjectConfig(name="can")]))
    router = cast(_Router, work._router)
    low, high = tea_box.mesh.bounds
    bus.arriving[ObjectsMessage].append(listed("can", "tea_box", "ghost"))
    until, frame = time.monotonic() + 10.0, 0

    def boxes() -> dict[str, tuple[float, float, float]]:
        found = {}
        for one in router.published[DETECTIONS][-1].detections:
            size = one.bbox.size
            found[one.results[0].hypothesis.class_id] = (size.x, size.y, size.z)
        return found

    while not router.published[DETECTIONS] or not boxes().get("tea_box", (0.0,))[0]:
        assert time.monotonic() < until
        frame += 1
        bus.arriving[PoseMessage] += [_now(name, frame) for name in ("can", "tea_box", "ghost")]
        work.step()
        time.sleep(0.03)
    assert boxes()["can"] == boxes()["tea_box"] == pytest.approx(tuple(high - low))
    assert boxes()["ghost"] == (0.0, 0.0, 0.0)
    (text,) = bus.logged["load"]
    assert text.startswith("object 'ghost': found no such")
