"""A recording of a camera that plays a known scene is that scene again; replayed, it is heard again."""

import json
import signal
import time

import msgspec
import numpy as np
import pytest

from huepose.datasets.bop import BopScene
from huepose.support.errors import InputError
from huepose_protos.buffers import frame_images, pack
from huepose_protos.client import Reader
from huepose_protos.examples import messages
from huepose_protos.local import endpoint
from huepose_protos.messages import FrameHeader, HealthMessage, PoseMessage, TruthMessage
from huepose_services.cli.main import main
from huepose_services.recording.replay import Recording
from huepose_services.recording.writer import SceneWriter

EXAMPLES = {type(m): m for m in messages()}


def _frame(number):
    """Header, colour and depth of a frame of 6 x 4 pixels."""
    rng = np.random.default_rng(number)
    color = rng.integers(0, 255, (4, 6, 3), dtype=np.uint8)
    depth = rng.integers(0, 65535, (4, 6), dtype=np.uint16)
    example = EXAMPLES[FrameHeader]
    size = msgspec.structs.replace(example.intrinsics, width=6, height=4)
    specs, payload = pack({"color": color, "depth": depth})
    header = msgspec.structs.replace(
        example, frame_id=number, capture_ns=10**9 + number * 33_333_333, intrinsics=size, buffers=specs
    )
    assert frame_images(header, payload)[0].shape == (4, 6, 3)
    return header, color, depth


def test_what_is_written_is_read_back_exactly(tmp_path):
    writer = SceneWriter(tmp_path / "out")
    for number in (7, 8, 12):
        writer.frame(*_frame(number))
    pose = EXAMPLES[PoseMessage]
    writer.message("huepose/a/b/pose/x/1", pose)
    writer.message("huepose/a/b/health/tracker", EXAMPLES[HealthMessage])
    writer.message("huepose/a/b/truth", msgspec.structs.replace(EXAMPLES[TruthMessage], frame_id=8))
    writer.close()
    assert (writer.frames, writer.dropped) == (3, 0)
    scene = BopScene(tmp_path / "out")
    assert scene.image_ids == (7, 8, 12)
    for number in scene.image_ids:
        header, color, depth = _frame(number)
        frame = scene.frame(number)
        assert (frame.color == color).all()
        assert frame.depth == pytest.approx(depth * 0.0001, abs=1e-6)
        assert frame.stamp_ns == header.capture_ns
        assert (frame.camera.fx, frame.camera.cy) == (header.intrinsics.fx, header.intrinsics.cy)
    truth = EXAMPLES[TruthMessage].objects[0]
    (label,) = scene.truths(8)
    assert (label.object_id, label.visib_fract) == (truth.object_id, truth.visib_fract)
    assert label.T_cam_obj[:3, 3] == pytest.approx(truth.translation)
    assert json.loads((tmp_path / "out" / "poses.jsonl").read_text()) == msgspec.to_builtins(pose) | {
        name: list(getattr(pose, name))
        for name in ("translation", "quaternion", "velocity_linear", "velocity_angular")
    }
    sizes = sum(path.stat().st_size for path in tmp_path.rglob("*.png"))
    assert writer.bytes >= sizes > 0


def test_whenever_it_is_cut_off_every_picture_by_name_is_whole(tmp_path):
    writer = SceneWriter(tmp_path)
    for number in range(3):
        writer.frame(*_frame(number))
    writer.commit(wait=True)
    for number in range(3, 6):
        writer.frame(*_frame(number))
    # Here the process dies: what was not committed has no name yet.
    scene = BopScene(tmp_path)
    assert scene.image_ids == (0, 1, 2)
    assert [scene.frame(i).frame_id for i in scene.image_ids] == [0, 1, 2]
    writer.close()
    assert BopScene(tmp_path).image_ids == tuple(range(6))
    assert not list(tmp_path.rglob("*.part"))


def test_a_folder_with_something_in_it_is_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="a new or empty folder"):
        SceneWriter(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_full_disk_is_an_error_that_leaves_what_was_committed(tmp_path, monkeypatch):
    writer = SceneWriter(tmp_path)
    writer.frame(*_frame(0))
    writer.commit(wait=True)

    def no_space(path, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", no_space)
    writer.frame(*_frame(1))
    with pytest.raises(OSError, match="No space left"):
        writer.commit(wait=True)
    with pytest.raises(OSError, match="No space left"):
        writer.close()
    assert BopScene(tmp_path).image_ids == (0,)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"nonsense\n", "a PoseMessage"),
        (b'{"object": "x"}\n', "a PoseMessage"),
        (b"[]\n", "a PoseMessage"),
        (b"\xff\xfe{}\n", "a PoseMessage"),
        (b"[" * 100_000 + b"\n", "a PoseMessage"),
        (b'{"quality": ' + b"9" * 10_000 + b"}\n", "a PoseMessage"),
        (b" " * 5_000_000 + b"\n", "over 4194304 bytes"),
    ],
)
def test_what_is_no_recording_is_refused_with_its_line(tmp_path, line, reason):
    (tmp_path / "poses.jsonl").write_bytes(line)
    with pytest.raises(InputError, match=r"poses.jsonl, line 1.*") as error:
        Recording(tmp_path)
    assert reason in str(error.value)


@pytest.mark.parametrize("key", ["health/../frame", "health/**", "", "health//camera", "Health/camera"])
def test_a_message_under_what_is_no_key_is_refused(tmp_path, key):
    (tmp_path / "poses.jsonl").write_text("")
    (tmp_path / "messages.jsonl").write_text(json.dumps({"key": key, "message": {}}) + "\n")
    with pytest.raises(InputError, match=r"messages.jsonl, line 1"):
        Recording(tmp_path)


def test_a_last_line_without_an_end_is_passed_over(tmp_path):
    writer = SceneWriter(tmp_path)
    writer.message("huepose/a/b/pose/x/1", EXAMPLES[PoseMessage])
    writer.close()
    with (tmp_path / "poses.jsonl").open("a") as file:
        file.write('{"object": "mus')
    assert len(Recording(tmp_path).events) == 1


@pytest.mark.live
def test_a_camera_is_recorded_and_replayed(pipeline, scene, huepose, base_port, tmp_path):
    path = pipeline(once=False, rate=20)
    out = tmp_path / "recording"
    camera = huepose("run", "camera", path)
    recorder = huepose("record", out, "--config", path)
    deadline = time.monotonic() + 60.0
    while len(list(out.glob("rgb/*.png"))) < 20:
        assert time.monotonic() < deadline
        time.sleep(0.1)
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(15.0) == 0
    camera.terminate()
    camera.wait(5.0)
    text = recorder.stderr.read()
    taken, source = BopScene(out), BopScene(scene)
    assert f"{len(taken.image_ids)} frames" in text
    assert "MB" in text
    for image in taken.image_ids:
        again, first = taken.frame(image), source.frame(3 + (image - 3) % 15)
        assert (again.color == first.color).all()
        assert again.depth == pytest.approx(first.depth, abs=1e-4)
    assert taken.labelled

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with Reader([endpoint(base_port)], "huepose/*/*/health/*") as reader:
        assert main(["replay", str(out), "--config", str(path), "--speed", "20"]) == 0
        assert reader.next(5.0).worker == "camera"
    for number, handler in before.items():
        signal.signal(number, handler)
