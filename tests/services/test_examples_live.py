"""The examples that pick and that publish to ROS 2, at a pipeline and at a router."""

from __future__ import annotations

import re
import signal
import subprocess
import threading
import time

import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

from huepose_protos.messages import CameraMessage, PoseMessage
from huepose_protos.motion import PoseAt, pose_at
from tests.services.conftest import heeds_ctrl_c, until
from tests.services.example_programs import (
    CAMERA_MESSAGE,
    EXAMPLE,
    MOUNT,
    ROOT,
    example,
    published,
    tracked,
)
from tests.services.sessions import listening


@pytest.mark.live
def test_nothing_is_picked_before_it_is_at_rest(base_port: int) -> None:
    endpoint, began = f"tcp/127.0.0.1:{base_port}", time.monotonic()

    def falls(number: int) -> PoseMessage:
        """Moves by 1 cm a frame for two seconds, then lies at z = 0.75 m."""
        still = {"velocity_linear": (0.0, 0.0, 0.0), "velocity_angular": (0.0, 0.0, 0.0)}
        return tracked(translation=(0.0, 0.0, 0.75 + 0.01 * max(60 - number, 0)), **still)

    with published(endpoint, falls, camera_after=100):
        picked = subprocess.run(
            example("03_pick_when_still.py", "tea_box", endpoint), check=True, capture_output=True, text=True
        )
    x, y, z = (float(n) for n in re.findall(r"\d\.\d*", picked.stdout))
    # In the robot's frame, although the camera's mount came late.
    assert (x, y) == MOUNT.translation[:2]
    assert z == pytest.approx(0.75 + MOUNT.translation[2], abs=0.004)
    assert time.monotonic() - began > 100 / 30


@pytest.mark.live
def test_of_two_instances_the_one_that_is_tracked_is_picked(base_port: int) -> None:
    """The other one was picked before, and is LOST. Of two that are TRACKING it is always the same."""
    endpoint = f"tcp/127.0.0.1:{base_port}"
    still = {"velocity_linear": (0.0, 0.0, 0.0), "velocity_angular": (0.0, 0.0, 0.0)}
    gone = {"state": "LOST", "translation": None, "quaternion": None, "covariance": None}
    none = {"velocity_linear": None, "velocity_angular": None}

    def lies(number: int) -> PoseMessage:
        first = {"instance": 4, **gone, **none}
        others = [{"instance": 5 + k, "translation": (0.0, 0.0, 0.5 + 0.25 * k), **still} for k in range(2)]
        return tracked(**[first, *others][2 - number % 3])

    with published(endpoint, lies, camera_after=-1):
        picked = subprocess.run(
            example("03_pick_when_still.py", "tea_box", endpoint),
            check=True,
            capture_output=True,
            text=True,
            timeout=60.0,
        )
    assert [float(n) for n in re.findall(r"\d\.\d*", picked.stdout)] == pytest.approx([0.1, 0.2, 0.8])


@pytest.mark.live
def test_nothing_is_picked_while_the_pose_of_a_moving_camera_is_unknown(base_port: int) -> None:
    """The object is at rest in the camera's frame, but its position in the robot's frame is unknown."""
    endpoint, late = f"tcp/127.0.0.1:{base_port}", threading.Event()
    late.set()
    still = {"velocity_linear": (0.0, 0.0, 0.0), "velocity_angular": (0.0, 0.0, 0.0)}

    def lies(number: int) -> PoseMessage:
        return tracked(translation=(0.0, 0.0, 0.75), **still)

    with (
        published(endpoint, lies, -1, lambda number: 300_000_000 if late.is_set() else 0),
        subprocess.Popen(
            example("03_pick_when_still.py", "tea_box", endpoint),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as picker,
    ):
        assert picker.stderr is not None
        try:
            waiting = picker.stderr.readline()
            assert picker.poll() is None
            late.clear()
            picked, _ = picker.communicate(timeout=30.0)
        finally:
            picker.terminate()
    assert waiting == "waiting: the camera pose is not known now\n"
    assert picker.returncode == 0
    assert [float(n) for n in re.findall(r"\d\.\d*", picked)] == pytest.approx([0.1, 0.2, 1.05])


@pytest.mark.live
def test_a_topic_arrives_at_a_router(base_port: int) -> None:
    router, poses = (f"tcp/127.0.0.1:{base_port + k}" for k in (0, 1))
    heard: list[zenoh.Sample] = []
    with zenoh.open(listening(router, mode="router")) as session, published(poses, lambda number: tracked()):
        session.declare_subscriber("0/pick/target/**", heard.append)
        bridge = subprocess.Popen(example("06_ros2.py", "tea_box", router, poses))
        try:
            until(lambda: heard or bridge.poll() is not None, 60.0)
        finally:
            bridge.terminate()
            bridge.wait()
    kind = "geometry_msgs/msg/PoseStamped"
    message = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(heard[0].payload.to_bytes(), kind)
    assert message.pose.position.z == EXAMPLE.translation[2]


@pytest.mark.live
def test_a_router_that_starts_late_gets_no_old_poses(base_port: int) -> None:
    router, poses = (f"tcp/127.0.0.1:{base_port + k}" for k in (0, 1))
    heard: list[zenoh.Sample] = []
    with published(poses, lambda number: tracked()):
        bridge = subprocess.Popen(
            example("06_ros2.py", "tea_box", router, poses), stderr=subprocess.PIPE, text=True
        )
        try:
            assert bridge.stderr is not None
            assert bridge.stderr.readline().startswith("no router of ROS 2 answers")
            time.sleep(1.0)
            began_ns = time.time_ns()
            with zenoh.open(listening(router, mode="router")) as session:
                session.declare_subscriber("0/pick/target/**", heard.append)
                until(lambda: heard or bridge.poll() is not None, 60.0)
        finally:
            bridge.terminate()
            bridge.communicate()
    store, kind = get_typestore(Stores.ROS2_JAZZY), "geometry_msgs/msg/PoseStamped"
    stamps = [store.deserialize_cdr(one.payload.to_bytes(), kind).header.stamp for one in heard]
    assert min(stamp.sec * 10**9 + stamp.nanosec for stamp in stamps) > began_ns


@pytest.mark.live
def test_without_a_router_a_topic_says_once_what_to_start_and_waits_until_ctrl_c(base_port: int) -> None:
    router, poses = (f"tcp/127.0.0.1:{base_port + k}" for k in (0, 1))
    with published(poses, lambda number: tracked()):
        bridge = subprocess.Popen(
            example("06_ros2.py", "tea_box", router, poses),
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=heeds_ctrl_c,
        )
        assert bridge.stderr is not None
        first = bridge.stderr.readline()
        time.sleep(4.0)  # it tries again, and again
        assert bridge.poll() is None
        bridge.send_signal(signal.SIGINT)
        more = bridge.communicate(timeout=15.0)[1]
    assert first == (
        f"no router of ROS 2 answers at {router}; `ros2 run rmw_zenoh_cpp rmw_zenohd` starts one. "
        "Waiting for it; Ctrl-C ends\n"
    )
    assert (more, bridge.returncode) == ("", 0)


def test_the_program_for_poses_on_the_robot_names_an_object_that_is_not_to_be_acted_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Client:
        def __init__(self, endpoints: list[str]) -> None: ...

        def __enter__(self) -> Client:
            return self

        def __exit__(self, *error: object) -> None: ...

        def camera(self, timeout_s: float) -> CameraMessage:
            return CAMERA_MESSAGE

        def next(self) -> PoseMessage:
            return EXAMPLE

        def at(self) -> PoseAt | None:
            return pose_at([tracked(state="SUSPECT")], EXAMPLE.capture_ns)

    monkeypatch.setattr("huepose_protos.PoseClient", Client, raising=False)
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / "ros2.md").read_text(), re.M | re.S)
    (program,) = [block for block in blocks if "client.at()" in block]
    exec(program, {})
    assert capsys.readouterr().out == "tea_box SUSPECT\n"
