"""A recording as a camera, and as a pipeline that is played and computed again."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from huepose.datasets.bop import BopScene
from huepose.model.io import model_path, save_model
from huepose.support.errors import InputError
from huepose_protos.client import Reader
from huepose_protos.examples import example
from huepose_protos.local import endpoint
from huepose_protos.messages import (
    CameraMessage,
    Mount,
    ObjectEntry,
    ObjectsMessage,
    PoseMessage,
    TruthMessage,
)
from huepose_protos.motion import mount_at
from huepose_services.camera.recording import RecordedScene
from huepose_services.chaos.system import LivePipeline
from huepose_services.cli.main import main
from huepose_services.recording.play import Player, in_order
from huepose_services.recording.read import Event, Recording
from huepose_services.runtime.bus import Bus
from tests.services.conftest import free_port_range, until

from .conftest import KEY, chunks_of, frames, mcap_of, parts, tiny_frame, written

POSE = example(PoseMessage)


def test_a_recording_is_a_camera(tmp_path):
    out = parts(tmp_path / "out")
    for number in (4, 4, 5):  # sent again, as the first frame of a recording is
        out.frame(*tiny_frame(number), KEY + "frame")
        out._due = 0.0
        out.commit()
    truth = msgspec.structs.replace(example(TruthMessage), frame_id=5)
    out.message(KEY + "truth", msgspec.structs.replace(truth, camera_epoch=tiny_frame(5)[0].camera_epoch))
    out.close()
    scene = RecordedScene(out.path)
    assert (scene.name, scene.image_ids) == ("out", (0, 1))
    for image, number in ((1, 5), (0, 4), (1, 5)):
        header, color, depth = tiny_frame(number)
        frame = scene.frame(image)
        assert (frame.color == color).all()
        assert frame.depth == pytest.approx(depth * 0.0001, abs=1e-6)
        assert scene.stamp_ns(image) == header.capture_ns
    assert scene.truths(0) == ()
    assert [t.object for t in scene.truths(1)] == ["006_mustard_bottle"]
    with pytest.raises(InputError, match="no frame"):
        RecordedScene(mcap_of(tmp_path / "x.mcap", topic="/other"))


@pytest.mark.parametrize("change", ["removed", "cut", "damaged"])
def test_a_recording_that_changes_while_it_is_played_is_reported(tmp_path, change):
    path = written(tmp_path / "out").path
    scene, content = RecordedScene(path), bytearray(path.read_bytes())
    place, chunk = next(Recording(path).chunks())
    if change == "removed":
        path.unlink()
    elif change == "cut":
        path.write_bytes(content[: place + 20])
    else:
        content[place + len(chunk.data) // 2] ^= 255
        path.write_bytes(content)
    with pytest.raises(InputError, match="another file than before"):
        scene.frame(0)


def test_a_recording_with_impossible_intrinsics_is_refused(tmp_path):
    out = parts(tmp_path / "out")
    header, color, depth = tiny_frame(4)
    far_off = msgspec.structs.replace(header.intrinsics, cx=1.5e308, cy=1.5e308)
    out.frame(msgspec.structs.replace(header, intrinsics=far_off), color, depth, KEY + "frame")
    out.close()
    with pytest.raises(InputError, match=r"out\.mcap: found .*principal point"):
        RecordedScene(out.path).frame(0)


class _Bus:
    """Keeps the published messages."""

    def __init__(self):
        self.out = []
        self.keys = self

    def of_tail(self, tail):
        return f"huepose/here/cam/{tail}"

    def put(self, key, message):
        self.out.append((key, message))

    def put_pixels(self, key, message, payload):
        self.out.append((key, message))


def _played(events, **options):
    bus = _Bus()
    player = Player(events, bus, **options)
    player.begin(5_000_000_000, player.next_ns)
    due = []
    while not player.finished:
        due.append(player.due_ns())
        player.play()
    return bus.out, due


def test_a_recording_is_played_in_order_with_its_ages_at_any_speed(tmp_path):
    events = list(Recording(written(tmp_path / "out").path).events())
    out, due = _played(events[::-1], speed=2.0)
    assert [m.frame_id for _, m in out] == [7, 7, 8, 8, 12, 12]
    assert due[0] == 5_000_000_000
    assert due[2] - due[0] == pytest.approx(33_333_333 / 2, abs=1)
    assert [m.publish_ns for _, m in out] == due
    assert [m.publish_ns - m.capture_ns for _, m in out] == [
        e.message.publish_ns - e.message.capture_ns for e in in_order(events)
    ]
    assert {key for key, _ in out} == {"huepose/here/cam/frame", "huepose/here/cam/pose/x/1"}
    # One camera epoch, which is not the recorded one.
    assert len({m.camera_epoch for _, m in out}) == 1
    assert out[0][1].camera_epoch != events[0].message.camera_epoch


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_played_mounts_and_epochs_are_of_the_time_of_the_playback(speed):
    second, mount = 10**9, Mount(parent="base", translation=(1.0, 0.0, 0.0))
    pose = msgspec.structs.replace(POSE, publish_ns=101 * second, capture_ns=101 * second - 10**7)
    entry = ObjectEntry(object="mug", max_instances=1, searching=0)
    over = msgspec.structs.replace(entry, object="jar", retired=(pose.camera_epoch, 3))
    stamps = range(100 * second, 102 * second, second // 20)
    camera = msgspec.structs.replace(example(CameraMessage), mount=mount)
    objects = ObjectsMessage(publish_ns=101 * second, objects=[entry, over])
    messages = [msgspec.structs.replace(camera, publish_ns=at + 10**6, mount_ns=at) for at in stamps]
    out, _ = _played([Event(KEY + "x", m) for m in (*messages, pose, objects)], speed=speed)
    played = {kind: [m for _, m in out if isinstance(m, kind)] for kind in map(type, (camera, pose, objects))}
    mounts = [(m.mount_ns, m.mount) for m in played[CameraMessage]]
    (pose,) = played[PoseMessage]
    assert mount_at(mounts, pose.capture_ns) == mount
    (objects,) = played[ObjectsMessage]
    assert [e.retired for e in objects.objects] == [None, (pose.camera_epoch, 3)]


def test_a_replay_can_be_stopped_before_it_begins(tmp_path, monkeypatch, capsys):
    path = tmp_path / "pipeline.yaml"
    path.write_text(json.dumps({"bus": {"base_port": free_port_range(20)}}))
    monkeypatch.setattr("huepose_services.cli.replay.catch_stop_signals", lambda: lambda: True)
    assert main(["replay", str(written(tmp_path / "out").path), "--config", str(path)]) == 0
    assert "stopped after" in capsys.readouterr().err


def test_recordings_of_several_cameras_are_played_each_as_its_own(tmp_path, monkeypatch, refused):
    """Together, as far apart in time as they were recorded; or one, as the named camera."""
    for camera, number in (("left", 4), ("right", 7)):  # a tenth of a second later
        out = parts(tmp_path / camera)
        out.frame(*tiny_frame(number), f"huepose/a/{camera}/frame")
        out.close()
        assert out.path == tmp_path / f"{camera}.mcap"
    path = tmp_path / "pipeline.yaml"
    cameras = [{"name": "left"}, {"name": "right"}]
    path.write_text(json.dumps({"site": "b", "cameras": cameras, "bus": {"base_port": free_port_range(40)}}))
    played = []

    def put(bus, key, header, payload):
        played.append((key, header.publish_ns))

    monkeypatch.setattr(Bus, "put_pixels", put)
    left, right = (str(tmp_path / f"{name}.mcap") for name in ("left", "right"))
    assert main(["replay", right, left, "--config", str(path)]) == 0
    assert [key for key, _ in played] == ["huepose/b/left/frame", "huepose/b/right/frame"]
    assert played[1][1] - played[0][1] == 3 * 33_333_333
    played.clear()
    assert main(["replay", left, "--config", str(path), "--camera", "right"]) == 0
    assert [key for key, _ in played] == ["huepose/b/right/frame"]
    path.write_text(json.dumps({"cameras": [{"name": "up"}, {"name": "down"}]}))
    assert "a recording of camera 'left'" in refused(["replay", left, "--config", path])


def test_parts_are_played_in_their_order_however_the_shell_sorts_them(tmp_path, monkeypatch):
    # In most languages a shell sorts out_0001.mcap before out.mcap.
    for part, name in enumerate(("out", "out_0001", "out_0002")):
        out = parts(tmp_path / name)
        out.note("huepose", {"part": str(part)})
        out.frame(*tiny_frame(part), KEY + "frame")
        out.close()
    other = parts(tmp_path / "another")
    other.frame(*tiny_frame(3), KEY + "frame")
    other.close()
    path = tmp_path / "pipeline.yaml"
    path.write_text(json.dumps({"bus": {"base_port": free_port_range(20)}}))
    played = []
    monkeypatch.setattr(Bus, "put_pixels", lambda bus, key, header, payload: played.append(header.frame_id))
    names = ("out_0001", "out_0002", "out", "another")
    files = [str(tmp_path / f"{name}.mcap") for name in names]
    monkeypatch.setattr("huepose_services.recording.play._REORDER_NS", 0)
    assert main(["replay", *files, "--config", str(path)]) == 0
    assert played == [0, 1, 2, 3]


@pytest.mark.parametrize("how", [[], ["--verify"]])
@pytest.mark.parametrize(
    ("camera", "number", "said"),
    [("cam1", 30, "a recording of camera 'cam1'"), ("cam0", 0, "a recording that began before the last one")],
)
def test_recordings_that_do_not_follow_each_other_are_not_mixed(tmp_path, refused, how, camera, number, said):
    for name, of, at in (("one", "cam0", 1000), ("two", camera, number)):
        out = parts(tmp_path / name)
        out.frame(*tiny_frame(at), f"huepose/a/{of}/frame")
        out.close()
    error = refused(["replay", tmp_path / "one.mcap", tmp_path / "two.mcap", *how])
    assert f"two.mcap: found {said}; expected the parts of one recording" in error


@pytest.mark.parametrize("how", [[], ["--verify"]])
def test_short_recordings_in_the_wrong_order_and_a_file_given_twice_are_refused(tmp_path, refused, how):
    for name, at in (("late", 30), ("early", 0)):
        out = parts(tmp_path / name)
        out.frame(*tiny_frame(at), KEY + "frame")
        out.close()
    late, early = tmp_path / "late.mcap", tmp_path / "early.mcap"
    error = refused(["replay", late, early, *how])
    assert "early.mcap: found a recording that began before the last one" in error
    error = refused(["replay", early, late, tmp_path / "." / "late.mcap", *how])
    assert "late.mcap: found the same file twice; expected each part once" in error


@pytest.mark.live
@pytest.mark.usefixtures("same_handlers")
def test_a_camera_is_recorded_and_replayed(pipeline, scene, huepose, base_port, tmp_path):
    path = pipeline(once=False, rate=20)
    out = tmp_path / "recording.mcap"
    camera = huepose("run", "camera", path)
    recorder = huepose("record", out, "--config", path, "--free", "0")
    other = huepose("record", tmp_path / "other", "--config", path, "--free", "0", "--json", "--jpeg")
    until(lambda: out.exists() and len(frames(Recording(out).events())) >= 20, 60.0)
    other.send_signal(signal.SIGINT)
    answered, noted = other.communicate(timeout=15.0)
    answer = json.loads(answered)
    assert f"other does not end in .mcap: the recording is written to {tmp_path / 'other.mcap'}" in noted
    assert answer["files"] == [str(tmp_path / "other.mcap")]
    assert answer["frames"] == len(frames(Recording(tmp_path / "other.mcap").events()))
    assert answer["bytes"] == (tmp_path / "other.mcap").stat().st_size
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(15.0) == 0
    camera.terminate()
    camera.wait(5.0)
    text = recorder.stderr.read()
    taken, source = RecordedScene(out), BopScene(scene)
    assert f"{len(taken.image_ids)} frames" in text
    assert "MB" in text
    for image in taken.image_ids:
        again, number = taken.frame(image), taken.frame(image).frame_id
        first = source.frame(3 + (number - 3) % 15)
        assert (again.color == first.color).all()
        assert again.depth == pytest.approx(first.depth, abs=1e-4)
    assert taken.truths(taken.image_ids[len(taken.image_ids) // 2])

    with Reader([endpoint(base_port)], "huepose/*/*/health/*") as reader:
        assert main(["replay", str(out), "--config", str(path), "--speed", "20"]) == 0
        assert reader.next(5.0).worker == "camera"


@pytest.mark.live
@pytest.mark.timeout(240)
@pytest.mark.parametrize("verb", ["record", "view"])
def test_a_waiting_command_finds_a_pipeline_that_starts_at_another_port(
    verb, pipeline, huepose, tea_box, tmp_path, monkeypatch
):
    """In a folder without its pipeline.yaml."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = pipeline(once=False, rate=20)
    (tmp_path / "bundles").mkdir()
    save_model(tea_box, model_path(tmp_path / "bundles", "tea_box"))
    own = {"bundles": str(tmp_path / "bundles"), "objects": [{"name": "tea_box"}]}
    path.write_text(json.dumps(json.loads(path.read_text()) | own))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    if verb == "view":
        pytest.importorskip("rerun", reason="rerun is not installed")
    waiting = huepose(
        *(["record", "out", "--free", "0"] if verb == "record" else ["view", "--save", "v.rrd"])
    )
    said = iter(waiting.stderr.readline, "")
    assert any("waiting for a pipeline" in line for line in said)
    huepose("run", "camera", path)
    assert any("which runs from" in line for line in said)
    # The file that it writes grows.
    file = Path("out.mcap" if verb == "record" else "v.rrd")
    begun = until(lambda: file.exists() and file.stat().st_size, 60.0)
    until(lambda: file.stat().st_size > 2 * begun, 60.0)
    waiting.send_signal(signal.SIGINT)
    _, err = waiting.communicate(timeout=30.0)
    assert waiting.returncode == 0, err


@pytest.mark.live
@pytest.mark.timeout(900)
def test_a_live_pipeline_is_computed_again_bit_by_bit(huepose, wait_until, tmp_path):
    """At 10 Hz, because a busy computer may be too slow for 30. The recording begins before the pipeline, so
    nothing has to be skipped. It is long enough for two states of the tracker, so there is enough to compare
    even if a step was lost on a busy computer. Cut anywhere, it keeps its whole chunks."""
    out = tmp_path / "live.mcap"
    system = LivePipeline(slow=3.0)
    recorder = huepose("record", out, "--config", system.path, "--free", "0")
    with system:
        wait_until(lambda: len({p.frame for p in system.poses if p.error is not None}) >= 120, 600.0)
        recorder.send_signal(signal.SIGINT)
        assert recorder.wait(30.0) == 0
    command = [sys.executable, "-m", "huepose_services.cli.main", "replay", "--verify", "--json", str(out)]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=300.0, check=False)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    report = json.loads(answer.stdout)
    assert report["steps"] >= 20, report
    assert report["poses"] >= 20, report

    recording = Recording(out)
    keys = [[e.key for e in recording.inside(chunk, pixels=False)] for _, chunk in recording.chunks()]
    ends = [index.chunk_start_offset + index.chunk_length for index in chunks_of(out)]
    for cut in sorted(np.random.default_rng(0).integers(8, out.stat().st_size, 20), reverse=True):
        os.truncate(out, cut)
        whole = keys[: int(np.searchsorted(ends, cut, "right"))]
        assert [e.key for e in Recording(out).events()] == [key for chunk in whole for key in chunk]
