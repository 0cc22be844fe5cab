"""Every example runs as it is written: on the folder of `huepose new`, at a pipeline, at a ROS 2 router."""

from __future__ import annotations

import ast
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

from huepose.model import ReferenceModel, save_model
from huepose.scenes.builtin import first_shot
from huepose.scenes.camera import CAMERA
from huepose_protos import encode
from huepose_protos.examples import example
from huepose_protos.keys import Keys
from huepose_protos.messages import CameraMessage, Mount, ObjectEntry, ObjectsMessage, PoseMessage
from huepose_protos.motion import PoseAt, pose_at
from huepose_services.camera.python import open_source
from huepose_services.cli.new import write_frame
from huepose_services.runtime.config import BusConfig, Config, load
from huepose_services.runtime.running import described, noted
from tests.services.conftest import heeds_ctrl_c, until
from tests.services.repeating import repeating
from tests.services.sessions import listening

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
EXAMPLE = example(PoseMessage)
CAMERA_MESSAGE = example(CameraMessage)
MOUNT = Mount(parent="base_link", translation=(0.1, 0.2, 0.3), quaternion=(0.0, 0.0, 0.0, 1.0))


@pytest.fixture(scope="module")
def folder(tea_box: ReferenceModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `huepose new tea_box examples/tea_box.obj` makes, without the mesh file."""
    out = tmp_path_factory.mktemp("new") / "tea_box"
    save_model(tea_box, out / "bundles" / "tea_box.huepose")
    write_frame(out, first_shot({"tea_box": tea_box.mesh}), CAMERA)
    return out


@pytest.fixture(scope="module")
def true_position(tea_box: ReferenceModel) -> np.ndarray:
    return first_shot({"tea_box": tea_box.mesh}).labels.T_cam_obj[0][:3, 3]


def example(name: str, *arguments: str | Path) -> list[str]:
    return [sys.executable, str(ROOT / "examples" / name), *map(str, arguments)]


def answer(name: str, folder: Path) -> tuple[str, list[float]]:
    """State and position of the first pose that an example prints."""
    done = subprocess.run(example(name, folder), check=True, capture_output=True, text=True)
    words = done.stdout.splitlines()[0].split(maxsplit=3)
    assert words[0] == "tea_box"
    return words[1], [float(x) for x in re.findall(r"-?\d+\.\d*", words[3])]


@pytest.mark.parametrize("name", ["01_one_frame.py", "05_own_detector.py"])
def test_an_example_prints_the_pose_in_a_frame(name: str, folder: Path, true_position: np.ndarray) -> None:
    state, position = answer(name, folder)
    assert state == "TRACKING"
    assert np.allclose(position, true_position, atol=0.005)


@pytest.mark.parametrize("name", ["01_one_frame.py", "05_own_detector.py"])
def test_a_folder_without_a_frame_is_reported_in_one_line(name: str, tmp_path: Path) -> None:
    done = subprocess.run(example(name, tmp_path / "no"), capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"{tmp_path / 'no'}")
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 1


def test_the_camera_gives_frames(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRAME_FOLDER", str(folder))
    pipeline = tmp_path / "pipeline.yaml"
    camera = ROOT / "examples" / "04_own_camera.py"
    pipeline.write_text(f"camera: {{source: python, path: {camera}}}\nworkers: [camera]\nbundles: bundles\n")
    opened = open_source(load(pipeline)).open()
    one, two = opened.read(1.0), opened.read(1.0)
    assert one is not None
    assert two is not None
    assert one.color.shape == (CAMERA.height, CAMERA.width, 3)
    assert (one.color != two.color).any()
    assert one.device_ns < two.device_ns


@contextmanager
def published(
    endpoint: str,
    pose: Callable[[int], PoseMessage],
    camera_after: int | None = None,
    late_ns: Callable[[int], int] | None = None,
) -> Iterator[None]:
    """Publishes a pipeline's poses, thirty a second, at an endpoint, and after some of them the camera's
    mount. pose: gives the message of a number; late_ns: gives the age of a moving camera's mount at a
    number."""

    def publish(number: int) -> None:
        now = time.monotonic_ns()
        changes = {"frame_id": number, "capture_ns": now, "publish_ns": now}
        offset = time.time_ns() - now
        message = msgspec.structs.replace(pose(number), **changes, realtime_offset_ns=offset)
        keys = Keys("lab", "cam0")
        session.put(keys.pose(message.object, message.instance), encode(message))
        if camera_after is not None and number > camera_after:
            mount_ns = None if late_ns is None else now - late_ns(number)
            said = msgspec.structs.replace(
                CAMERA_MESSAGE, frame=message.frame, mount=MOUNT, mount_ns=mount_ns, publish_ns=now
            )
            session.put(keys.camera_info, encode(said))

    with zenoh.open(listening(endpoint)) as session, repeating(publish, 1 / 30):
        yield


def tracked(**changes: object) -> PoseMessage:
    return msgspec.structs.replace(EXAMPLE, **{"object": "tea_box", "state": "TRACKING", **changes})


@pytest.mark.live
def test_the_subscriber_prints_what_comes_and_why_nothing_comes(base_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{base_port}"
    with subprocess.Popen(
        example("02_live_subscriber.py", endpoint), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as reader:
        assert reader.stdout is not None
        assert reader.stderr is not None
        try:
            said = f"waiting for a gateway at {endpoint}: no program listens there\n"
            assert reader.stderr.readline() == said
            with published(endpoint, lambda number: tracked()):
                assert reader.stdout.readline().startswith(f"tea_box {EXAMPLE.instance} TRACKING")
        finally:
            reader.terminate()


@pytest.mark.live
def test_the_subscriber_ends_quietly_when_its_output_is_closed(base_port: int) -> None:
    """As `| head` does: it closes the pipe."""
    endpoint = f"tcp/127.0.0.1:{base_port}"
    with (
        published(endpoint, lambda number: tracked()),
        subprocess.Popen(
            example("02_live_subscriber.py", endpoint),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as reader,
    ):
        assert reader.stdout is not None
        assert reader.stderr is not None
        try:
            assert reader.stdout.readline()
            reader.stdout.close()
            assert reader.wait(15.0) == 0
            assert reader.stderr.read() == ""
        finally:
            reader.terminate()


def first_words(*commands: list[str]) -> list[str]:
    """The first line of each command's error output; all wait at the same time."""
    running = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for command in commands]
    try:
        return [one.stderr.readline() for one in running if one.stderr is not None]
    finally:
        for one in running:
            one.terminate()
            one.communicate()


@pytest.mark.live
def test_a_pipeline_that_is_being_started_is_distinguished_from_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    with noted(described(Config(), tmp_path / "pipeline.yaml")):
        lines = first_words(example("02_live_subscriber.py"), example("03_pick_when_still.py", "tea_box"))
    said = f"waiting for a pipeline: local/cam0, from {tmp_path / 'pipeline.yaml'}, is being started"
    assert [said in line for line in lines] == [True, True], lines


@pytest.mark.live
@pytest.mark.parametrize(
    "script", [["02_live_subscriber.py"], ["03_pick_when_still.py", "box"], ["06_ros2.py", "box", "tcp/a:1"]]
)
def test_a_wrong_address_and_a_choice_of_pipelines_are_one_sentence(
    script: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    ports = (17447, 17547)
    left, right = (described(Config(bus=BusConfig(base_port=n)), tmp_path / f"{n}.yaml") for n in ports)
    for also, said in ([], "found 2 pipelines that run here"), (["tcp/foo:bar"], "found 'tcp/foo:bar'"):
        with noted(left), noted(right):
            done = subprocess.run(example(*script, *also), capture_output=True, text=True, timeout=60.0)
        assert done.returncode == 1
        assert said in done.stderr
        assert done.stderr.count("\n") == 1, done.stderr


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


@contextmanager
def listed(endpoint: str, outside: bool) -> Iterator[None]:
    """Publishes the list of objects and the camera of a pipeline, as outside or as inside."""
    keys = Keys("lab", "cam0")
    key = keys.outside(keys.objects) if outside else keys.objects
    said = ObjectsMessage(
        publish_ns=1,
        objects=[ObjectEntry(object=name, max_instances=1, searching=1) for name in ("tea_box", "carton")],
    )
    with zenoh.open(listening(endpoint)) as session:
        session.declare_queryable(key, lambda query: query.reply(key, encode(said)))

        def publish_camera(_: int) -> None:
            session.put(keys.camera_info, encode(CAMERA_MESSAGE))

        with repeating(publish_camera, 0.1):
            yield


@pytest.mark.live
def test_a_name_that_is_not_searched_for_is_reported_with_those_that_are(base_port: int) -> None:
    inside, outside = (f"tcp/127.0.0.1:{base_port + k}" for k in (0, 1))
    with listed(inside, outside=False), listed(outside, outside=True):
        lines = first_words(*(example("03_pick_when_still.py", "crton", at) for at in (inside, outside)))
    assert lines == ["waiting: crton is not searched for; searched for: carton, tea_box\n"] * 2


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
            with zenoh.open(listening(router, mode="router")) as session:
                began_ns = time.time_ns()
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


def test_every_example_says_how_it_is_run_and_is_listed() -> None:
    listed = re.findall(r"examples/(\w+\.py)", (ROOT / "docs" / "quickstart.md").read_text())
    assert sorted(set(listed)) == [path.name for path in EXAMPLES]
    for path in EXAMPLES:
        assert f"examples/{path.name}" in (ast.get_docstring(ast.parse(path.read_text())) or "")
