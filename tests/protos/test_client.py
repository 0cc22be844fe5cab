"""Which messages the clients keep, and which pipeline they assign them to."""

import json
import os
import re
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
import zenoh

from huepose_protos import PoseClient, encode
from huepose_protos.client import Reader, peer
from huepose_protos.examples import example
from huepose_protos.local import endpoint
from huepose_protos.messages import CameraMessage, Clock, Mount, PoseMessage

NOBODY = "tcp/127.0.0.1:1"
SECOND = 10**9


def sample(key, message):
    """A message as zenoh delivers it."""
    data = encode(message)
    return SimpleNamespace(key_expr=key, attachment=None, payload=SimpleNamespace(to_bytes=lambda: data))


def pose(site, epoch, capture_ns, x=0.0, **changes):
    fields = {"object": "mug", "instance": 0, "state": "TRACKING", "frame": "cam0_color_optical"}
    fields |= {"camera_epoch": epoch, "capture_ns": capture_ns, "publish_ns": capture_ns}
    fields |= {"translation": (x, 0.0, 0.5), "realtime_offset_ns": 0, "clock_id": "of another machine"}
    message = msgspec.structs.replace(example(PoseMessage), **(fields | changes))
    return sample(f"huepose/{site}/cam0/pose/mug/0", message)


def camera(site, epoch, x, mount_ns=None, boot="of another machine"):
    message = msgspec.structs.replace(
        example(CameraMessage),
        camera_epoch=epoch,
        clock=Clock(clock_id=boot, realtime_offset_ns=0),
        frame="cam0_color_optical",
        mount=Mount(parent="base", translation=(x, 0.0, 0.0)),
        mount_ns=mount_ns,
    )
    return sample(f"huepose/{site}/cam0/camera", message)


@pytest.fixture
def client():
    with PoseClient(NOBODY) as client:
        yield client


@pytest.mark.parametrize("uptime_s", [50, 200, 201, 300])
def test_a_moving_camera_has_the_mounts_sent_since_its_computer_restarted(client, uptime_s):
    """Whether the new uptime is shorter or longer than the old one."""
    for boot, epoch, began_s, x in (("first", 1, 200, 1.0), ("second", 2, uptime_s, 5.0)):
        for tenth in range(30):
            client._on_sample(camera("lab", epoch, x, began_s * SECOND + tenth * SECOND // 10, boot))
        client._on_sample(pose("lab", epoch, (began_s + 1) * SECOND, clock_id=boot))
        assert client.mount(client.latest()).translation == (x, 0.0, 0.0)


def test_two_sites_with_the_same_camera_name_keep_their_own_poses_and_mounts(client):
    sites = {"robot_a": (11, 100 * SECOND, 1.0), "robot_b": (22, 7000 * SECOND, 9.0)}
    for site, (epoch, _, x) in sites.items():
        client._on_sample(camera(site, epoch, x))
    for tenth in range(3):
        for site, (epoch, began_ns, x) in sites.items():
            client._on_sample(pose(site, epoch, began_ns + tenth * SECOND // 10, x / 10.0))
    client._on_sample(pose("robot_a", 11, 100 * SECOND + 3 * SECOND // 10, 0.1))
    between = client.at(100 * SECOND + SECOND // 20)
    assert (between.ahead_s, between.T_parent_obj[0, 3]) == (0.0, pytest.approx(1.1))
    on_robot = {one.camera_epoch: one.translation[0] for one in map(client.on_robot, heard(client))}
    assert on_robot == pytest.approx({11: 1.1, 22: 9.9})


@pytest.mark.parametrize(("ago_s", "silent_s"), [(5.0, 5.0), (-5.0, 0.0)])
def test_a_pose_stored_by_a_gateway_is_as_old_as_its_image(client, ago_s, silent_s):
    """On another machine wall clocks give the age; if the other clock is ahead of ours, the age is 0."""
    now_ns = time.time_ns()
    client._on_reply(SimpleNamespace(ok=pose("lab", 1, now_ns - int(ago_s * SECOND))))
    assert client.silent_s() == pytest.approx(silent_s, abs=0.5)
    assert (client.latest(max_age_s=2.0) is None) == (silent_s > 2.0)
    client._on_sample(pose("lab", 1, now_ns + 6 * SECOND))
    assert client.silent_s() < 0.5


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["box", "mug"], "mug is not seen: `huepose status` says why"),
        (["box", "can"], "mug is not searched for, only box, can: `huepose status` says why"),
    ],
)
def test_a_client_of_one_object_says_why_none_of_its_poses_comes(monkeypatch, names, said):
    """Others may be seen: it does not hear their poses."""
    monkeypatch.setattr(PoseClient, "connected", True)
    with PoseClient(NOBODY, object="mug") as client:
        monkeypatch.setattr(client, "looked_for", lambda: names)
        assert client.why_silent() == f"connected, but {said}"


@pytest.mark.parametrize(
    ("names", "said"),
    [([], "; no object is searched for"), (["box"], ""), (None, "")],
    ids=["removed", "seen", "no answer"],
)
def test_a_client_whose_object_was_removed_says_so(monkeypatch, client, names, said):
    monkeypatch.setattr(PoseClient, "connected", True)
    monkeypatch.setattr(client, "looked_for", lambda: names)
    client._on_sample(pose("lab", 1, SECOND))
    assert re.fullmatch(rf"connected: the last pose came \d\.\d s ago{said}", client.why_silent())


@pytest.mark.parametrize("name", ["", "Tea Box", "tea#box", "tea/box"])
def test_a_client_of_an_object_with_an_invalid_name_is_refused(name):
    with pytest.raises(ValueError, match=r"is not a name of a-z, 0-9, _ and -"):
        PoseClient(NOBODY, object=name)


@pytest.mark.parametrize("rate_hz", [5, 30, 60, 240])
def test_poses_of_two_seconds_are_interpolated_at_any_rate_and_older_ones_forgotten(client, rate_hz):
    for number in range(4 * rate_hz):
        client._on_sample(pose("lab", 1, 100 * SECOND + number * SECOND // rate_hz, number / rate_hz))
    newest_ns = client.latest().capture_ns
    assert client.at(newest_ns - 2 * SECOND + 1).ahead_s == 0.0
    assert client.at(newest_ns - 3 * SECOND) is None


def test_repetitions_of_a_suspect_pose_are_not_new_messages(client, monkeypatch):
    """As they come once a second from a camera that has stopped."""
    now = time.monotonic()
    for second, state in enumerate(("TRACKING", "SUSPECT", "SUSPECT", "SUSPECT")):
        monkeypatch.setattr("huepose_protos.pose_client.time.monotonic", lambda at=now + second: at)
        client._on_sample(pose("lab", 1, SECOND, state=state, publish_ns=(1 + second) * SECOND))
    assert client.silent_s() == pytest.approx(2.0)
    assert client.latest(max_age_s=1.5) is None
    assert [one.state for one in heard(client)] == ["TRACKING", "SUSPECT"]


def heard(client):
    return iter(lambda: client.next(0.0), None)


def test_cameras_that_stopped_long_ago_are_forgotten(client, monkeypatch):
    for epoch in range(3):
        client._on_sample(camera("lab", epoch, 1.0))
    monkeypatch.setattr("huepose_protos.pose_client._FORGET_S", -1.0)
    client._on_sample(camera("lab", 3, 1.0))
    assert list(client._mounts) == [3]


def test_a_reader_that_is_not_read_keeps_the_newest_messages_and_counts_the_others(monkeypatch):
    monkeypatch.setattr("huepose_protos.client._WAITING", 3)
    with Reader([NOBODY], "huepose/**") as reader:
        for number in range(5):
            reader._on_sample(pose("lab", 1, SECOND, frame_id=number))
        assert (reader.pending, reader.missed) == (3, 2)
        assert [message.frame_id for message in heard(reader)] == [2, 3, 4]


def test_whoever_waits_for_a_message_of_a_reader_that_is_closed_gets_none():
    got = []
    with Reader([NOBODY], "huepose/**") as reader:
        waiting = threading.Thread(target=lambda: got.append(reader.next()), daemon=True)
        waiting.start()
    waiting.join(5.0)
    assert got == [None]
    assert reader.next() is None


def test_messages_that_cannot_be_decoded_do_not_prolong_the_wait_for_one_that_can():
    """As of a pipeline of another version: whoever asks in a loop whether to stop must get an answer."""
    enough = threading.Event()
    bad = SimpleNamespace(key_expr="huepose/lab/cam0/pose/mug/0", attachment=None)
    bad.payload = SimpleNamespace(to_bytes=lambda: b"of another version")
    with Reader([NOBODY], "huepose/**") as reader:

        def publish():
            for _ in range(10_000):
                reader._on_sample(bad)
                if enough.wait(0.002):
                    break

        publisher = threading.Thread(target=publish)
        publisher.start()
        assert reader.next(0.5) is None
        assert publisher.is_alive(), "it waited for the last of them"
        enough.set()
        publisher.join()


def note(folder, camera, port):
    said = {"site": "local", "camera": camera, "file": "pipeline.yaml"}
    (folder / f"{os.getpid()}-{port}.json").write_text(json.dumps(said))


def say(session, camera):
    message = msgspec.structs.replace(example(PoseMessage), object="mug", instance=0)
    session.put(f"huepose/local/{camera}/pose/mug/0", encode(message))


def test_a_client_of_a_named_camera_waits_for_it_and_gets_no_other_poses(monkeypatch, tmp_path):
    """Also if another camera has the default port."""
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    monkeypatch.setattr("huepose_protos.local._LOOK_EVERY_NS", 0)
    with PoseClient(None, site="local", camera="right") as client, zenoh.open(at(17447)) as left:
        note(tmp_path, "left", 17447)
        others = "no pipeline of local/right runs here, only local/left at port 17447 (pipeline.yaml)"
        assert f"waiting for a pipeline: {others}" in (client.why_silent() for _ in range(5))
        with zenoh.open(at(17467)) as right:
            note(tmp_path, "right", 17467)
            for _ in range(200):
                say(left, "left")
                say(right, "right")
                if (pose := client.next(0.1)) is not None:
                    break
            assert pose.object == "mug"
            assert {camera for camera, *_ in client._history} == {"local/right"}


def at(port):
    return peer([], listen=[endpoint(port)])


def test_the_page_reads_poses_of_two_cameras_in_the_frame_of_the_robot(monkeypatch, capsys):
    """Each pose with the mount of its own camera. A lost object, or a camera whose mount is not known yet,
    does not end the program."""
    page = (Path(__file__).parents[2] / "docs" / "cameras.md").read_text()
    (code,) = (one for one in re.findall(r"^```python\n(.*?)^```", page, re.M | re.S) if "PoseClient" in one)
    with PoseClient(NOBODY) as both:
        both._on_sample(pose("left", 1, SECOND, 0.1, frame="left_color_optical"))
        both._on_sample(camera("left", 1, 1.0))
        both._on_sample(camera("right", 2, 9.0))
        lost = {"state": "LOST", "translation": None, "quaternion": None}
        both._on_sample(pose("right", 2, 2 * SECOND, frame="right_color_optical", **lost))
        both._on_sample(pose("right", 2, 3 * SECOND, 0.2, frame="right_color_optical"))
        both._on_sample(pose("unknown", 3, 4 * SECOND, frame="other_color_optical"))
        both.close()
        monkeypatch.setattr("huepose_protos.PoseClient", lambda gateways: both)
        exec(compile(code, "cameras.md", "exec"), {"PoseClient": lambda gateways: both})
    assert capsys.readouterr().out.splitlines() == [
        "left_color_optical mug (1.1, 0.0, 0.5)",
        "right_color_optical mug (9.2, 0.0, 0.5)",
    ]


def test_workers_of_another_pipeline_at_the_next_ports_do_not_count(tmp_path):
    """Two pipelines of six workers may have ports that are six apart; each is looked for at eleven."""
    places = [endpoint(number, tmp_path) for number in (1, 7)]
    with ExitStack() as around:
        tokens = []
        for place, site in zip(places, ("lab", "hall"), strict=True):
            session = around.enter_context(zenoh.open(peer([], [place])))
            tokens.append(session.liveliness().declare_token(f"huepose/{site}/cam0/live/tracker"))
        every = around.enter_context(Reader(places, "huepose/*/*/health/*"))
        mine = around.enter_context(Reader(places, "huepose/lab/cam0/health/*", "huepose/lab/cam0/objects"))
        deadline = time.monotonic() + 10.0
        while not (len(every.live) == 2 and mine.seen):
            assert time.monotonic() < deadline
            time.sleep(0.02)
        assert mine.live == {"huepose/lab/cam0/live/tracker"}
        tokens[0].undeclare()
        while mine.gone_since is None or len(every.live) == 2:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        assert (mine.live, every.live) == (set(), {"huepose/hall/cam0/live/tracker"})
