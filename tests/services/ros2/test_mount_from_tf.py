"""The camera pose from /tf: messages of another library than the one that reads them, over a router."""

from __future__ import annotations

import time
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import zenoh
from mcap_ros2._dynamic import serialize_dynamic
from zenoh import ext

from huepose_protos import WireError, decode
from huepose_protos.messages import Mount, MountMessage
from huepose_services.following import Follower
from huepose_services.ros2.messages import TRANSFORMS, transforms_in, types
from huepose_services.ros2.publisher import Node, topic_key
from huepose_services.ros2.work import MountFromTf, Ros2Work, Router, open_ros_session
from huepose_services.runtime.config import BusConfig, Config, Ros2Config
from huepose_services.runtime.config_perception import TfConfig
from tests.services.conftest import until
from tests.services.sessions import close_bus, listening, open_bus

QUARTER = 0.5**0.5


def written(*moves: tuple[int, str, str, tuple[float, ...], tuple[float, ...]]) -> bytes:
    """TFMessage in CDR: Unix time, parent, child, translation, quaternion."""
    text, _ = types().generate_msgdef(TRANSFORMS, ros_version=2)
    short = TRANSFORMS.replace("/msg/", "/")
    names = SimpleNamespace
    transforms = [
        names(
            header=names(stamp=names(sec=ns // 10**9, nanosec=ns % 10**9), frame_id=parent),
            child_frame_id=child,
            transform=names(
                translation=names(x=t[0], y=t[1], z=t[2]), rotation=names(x=q[0], y=q[1], z=q[2], w=q[3])
            ),
        )
        for ns, parent, child, t, q in moves
    ]
    return bytes(serialize_dynamic(short, text)[short](names(transforms=transforms)))


def fail(error: WireError) -> None:
    raise error


def test_transforms_of_another_library_are_read() -> None:
    at = 1_700_000_000_123_456_789
    data = written(
        (at, "/base_link", "tool0", (1.0, -2.0, 0.5), (0.0, 0.0, QUARTER, QUARTER)),
        (at + 1, "tool0", "camera", (0.0, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0)),
    )
    first, second = transforms_in(data, fail)
    assert first[:2] == (at, "tool0")
    assert first[2].parent == "base_link"
    assert first[2].translation == (1.0, -2.0, 0.5)
    assert np.allclose(first[2].quaternion, (0.0, 0.0, QUARTER, QUARTER), atol=1e-15)
    expected = Mount(parent="tool0", translation=(0.0, 0.0, 0.1))
    assert second == (at + 1, "camera", expected)


def test_an_invalid_transform_does_not_affect_the_others() -> None:
    data = written(
        (5, "base", "wheel", (float("nan"), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        (5, "base", "mimic", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        (5, "base", "tool", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)),
    )
    said: list[WireError] = []
    (left,) = transforms_in(data, said.append)
    assert left[1] == "tool"
    assert ["wheel" in str(said[0]), "mimic" in str(said[1])] == [True, True]


def test_bytes_that_are_no_message_are_refused_and_raise_nothing() -> None:
    data = written((5, "base", "tool", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)))
    rng = np.random.default_rng(0)
    cases = [data[:n] for n in range(len(data))] + [rng.bytes(80) for _ in range(100)]
    cases.append(bytes(2 * 1024 * 1024))
    for case in cases:
        said: list[WireError] = []
        assert transforms_in(case, said.append) == [] or case not in cases[: len(data)]
    assert said, "of the last, which is too long"


@pytest.mark.live
def test_the_worker_ignores_its_own_transforms(base_port: int) -> None:
    connect = f"tcp/127.0.0.1:{base_port + 9}"
    config = Config(bus=BusConfig(base_port=base_port), ros2=Ros2Config(connect=connect))
    bus = open_bus(config, "ros2")
    mount = MountFromTf(bus, TfConfig(parent="base_link", child="camera"))
    with zenoh.open(listening(connect, mode="router")) as robot, open_ros_session(config.ros2) as session:
        node = Node(session, "huepose", 0, "rmw_zenoh")
        mount.listen(node)
        key = topic_key("/tf", TRANSFORMS, 0, "rmw_zenoh")

        def say() -> None:
            for parent, child, put in (
                ("camera", "box_0", partial(node.publish, "/tf", TRANSFORMS)),
                ("base_link", "tool0", partial(robot.put, key)),
            ):
                put(written((time.time_ns(), parent, child, (0.0,) * 3, (0.0, 0.0, 0.0, 1.0))))
            time.sleep(0.05)
            mount.step()

        until(lambda: "tool0" in mount._tree.frames, 20.0, say)
        assert mount._tree.frames == ("base_link", "tool0")
        bus.close()
    bus.session.close()


@pytest.mark.live
def test_the_camera_gets_the_pose_that_the_robot_publishes(base_port: int) -> None:
    connect = f"tcp/127.0.0.1:{base_port + 9}"
    config = Config(bus=BusConfig(base_port=base_port), ros2=Ros2Config(connect=connect))
    bus, camera = (open_bus(config, worker) for worker in ("ros2", "camera"))
    mounts: list[MountMessage] = []
    camera.session.declare_subscriber(
        config.keys.mount, lambda sample: mounts.append(decode(sample.payload.to_bytes(), MountMessage))
    )

    def warnings() -> str:
        return " ".join(bus.health.message().warnings)

    with zenoh.open(listening(connect, mode="router")) as robot:
        # As rmw_zenoh keeps a message that is published once, before anybody listens.
        static = ext.declare_advanced_publisher(
            robot,
            topic_key("/tf_static", TRANSFORMS, 0, "rmw_zenoh"),
            cache=ext.CacheConfig(max_samples=1),
            publisher_detection=True,
        )
        static.put(written((1, "tool0", "camera", (0.0, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0))))
        router = Router(config.ros2)
        mount = MountFromTf(bus, TfConfig(parent="base_link", child="camera"))
        work = Ros2Work(bus, router, config.ros2, {}, Follower(bus, dict, []), mount)
        until(lambda: "known frames: camera, tool0" in warnings(), 20.0, work.step)
        told: list[int] = []
        key = topic_key("/tf", TRANSFORMS, 0, "rmw_zenoh")

        def said() -> bool:
            told.append(at_ns := time.time_ns())
            robot.put(
                key, written((at_ns, "base_link", "tool0", (1.0, 2.0, 3.0), (QUARTER, 0.0, 0.0, QUARTER)))
            )
            return len(mounts) >= 3

        until(said, 20.0, work.step)
        off_ns = time.monotonic_ns() - time.time_ns()
        last = mounts[-1]
        assert last.mount.parent == "base_link"
        # A rotation by 90 degrees about x takes the tool's z to the base's -y.
        assert np.allclose(last.mount.translation, (1.0, 1.9, 3.0))
        assert min(abs(last.capture_ns - (at_ns + off_ns)) for at_ns in told) < 500_000_000
        assert len({message.capture_ns for message in mounts}) == len(mounts)
        until(lambda: said() and "tf" not in warnings(), 20.0, work.step)
        robot.put(
            key, written((time.time_ns() - 9 * 10**9, "base_link", "tool0", (0.0,) * 3, (0.0, 0.0, 0.0, 1.0)))
        )
        until(lambda: "timestamps 9" in warnings(), 20.0, work.step)
        tokens = {str(r.ok.key_expr) for r in robot.liveliness().get("@ros2_lv/**") if r.ok is not None}
        assert any("/MS/%/%/huepose/%tf_static/" in token for token in tokens)
    close_bus(bus)
    close_bus(camera)
