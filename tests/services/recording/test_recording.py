"""What is recorded is read back exactly, by others too; however it ends, what was written stays."""

import json
import signal
import struct
import time
import tracemalloc

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from huepose.datasets.bop import BopScene
from huepose.support.errors import InputError
from huepose_protos.buffers import frame_images
from huepose_protos.client import Reader
from huepose_protos.local import endpoint
from huepose_protos.messages import FrameHeader, PoseMessage, TruthMessage
from huepose_services.camera.recording import RecordedScene
from huepose_services.cli.main import main
from huepose_services.recording.export import export_bop
from huepose_services.recording.parts import DiskIsFull, Limits
from huepose_services.recording.play import Player, in_order, said_by
from huepose_services.recording.read import Recording

from .conftest import EXAMPLES, KEY, UNIX_NS, parts, tiny_frame

POSE = EXAMPLES[PoseMessage]


def _written(path, numbers=(7, 8, 12), jpeg=False, chunks=False):
    """A recording of frames with a pose after each."""
    out = parts(path, jpeg=jpeg)
    for number in numbers:
        header, color, depth = tiny_frame(number)
        out.frame(header, color, depth, KEY + "frame")
        pose = msgspec.structs.replace(POSE, frame_id=number, publish_ns=header.publish_ns + 1)
        out.message(KEY + "pose/x/1", pose)
        if chunks:
            out._part._due = 0.0
            out.commit()
    out.close()
    return out


def _frames(events):
    return [
        (e.message, *frame_images(e.message, e.payload)) for e in events if isinstance(e.message, FrameHeader)
    ]


def test_what_is_written_is_read_back_exactly(tmp_path):
    out = _written(tmp_path / "out")
    assert out.path == tmp_path / "out.mcap"
    assert out.size == out.path.stat().st_size
    recording = Recording(out.path)
    events = list(recording.events())
    assert (recording.cut, recording.exact) == ("", True)
    assert recording.notes["huepose"]["site"] == "a"
    for (header, color, depth), number in zip(_frames(events), (7, 8, 12), strict=True):
        expected = tiny_frame(number)
        assert header == expected[0]
        assert (color == expected[1]).all()
        assert (depth == expected[2]).all()
    assert [e.message.frame_id for e in events] == [7, 7, 8, 8, 12, 12]
    assert {e.key for e in events} == {KEY + "frame", KEY + "pose/x/1"}
    assert msgspec.structs.replace(events[1].message, frame_id=42, publish_ns=POSE.publish_ns) == POSE


def test_other_programs_read_it_by_well_known_schemas(tmp_path):
    path = _written(tmp_path / "out.mcap", numbers=(7,)).path
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        shown = {c.topic: (s.name, m) for s, c, _, m in reader.iter_decoded_messages(topics=SHOWN)}
        said = {
            c.topic: (c.message_encoding, s, m)
            for s, c, m in reader.iter_messages()
            if c.topic.startswith(KEY)
        }
    header, color, depth = tiny_frame(7)
    assert {topic: name for topic, (name, _) in shown.items()} == {
        "/cam0/color": "foxglove.RawImage",
        "/cam0/depth": "foxglove.RawImage",
        "/cam0/calibration": "foxglove.CameraCalibration",
        "/cam0/pose/006_mustard_bottle/3": "foxglove.PoseInFrame",
        "/tf": "foxglove.FrameTransform",
    }
    image = shown["/cam0/color"][1]
    assert (image.encoding, image.width, image.height, image.step) == ("rgb8", 6, 4, 18)
    assert image.data == color.tobytes()
    assert shown["/cam0/depth"][1].encoding == "16UC1"
    assert shown["/cam0/depth"][1].data == depth.tobytes()
    assert image.timestamp.ToNanoseconds() == header.capture_ns + UNIX_NS
    assert list(shown["/cam0/calibration"][1].K)[:3] == [500.0, 0.0, 1.5]
    pose = shown["/cam0/pose/006_mustard_bottle/3"][1]
    assert pose.frame_id == image.frame_id == "cam0_color_optical"
    assert (pose.pose.position.z, pose.pose.orientation.w) == (POSE.translation[2], POSE.quaternion[3])
    turned = shown["/tf"][1]
    assert (turned.parent_frame_id, turned.child_frame_id) == ("cam0_color_optical", "006_mustard_bottle/3")
    encoding, schema, message = said[KEY + "pose/x/1"]
    assert (encoding, schema.encoding, schema.name) == ("json", "jsonschema", "PoseMessage")
    assert json.loads(schema.data)["type"] == "object"
    assert json.loads(message.data)["quality"] == POSE.quality


SHOWN = ["/cam0/color", "/cam0/depth", "/cam0/calibration", "/cam0/pose/006_mustard_bottle/3", "/tf"]


def test_jpeg_is_smaller_and_says_so(tmp_path):
    recording = Recording(_written(tmp_path / "out", jpeg=True).path)
    for (_, color, depth), number in zip(_frames(recording.events()), (7, 8, 12), strict=True):
        assert color.shape == (4, 6, 3)
        assert (depth == tiny_frame(number)[2]).all()
    assert not recording.exact


def test_cut_at_any_byte_it_is_readable_up_to_the_last_chunk(tmp_path):
    path = _written(tmp_path / "out", numbers=range(8), chunks=True).path
    whole, data = list(Recording(path).events()), path.read_bytes()
    ends = [index.chunk_start_offset + index.chunk_length for index in _chunks(path)]
    assert len(ends) == 8
    rng = np.random.default_rng(0)
    for cut in [*rng.integers(8, len(data), 60), *ends, ends[3] - 1]:
        path.write_bytes(data[:cut])
        recording = Recording(path)
        events = list(recording.events())
        # Two events in each chunk.
        assert events == whole[: 2 * sum(end <= cut for end in ends)]
        assert recording.cut == "it was cut off"


def test_every_chunk_is_on_the_disk_when_it_is_done(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr("os.fdatasync", lambda number: synced.append(number))
    out = parts(tmp_path / "out")
    out.frame(*tiny_frame(0), KEY + "frame")
    out.commit()
    assert not synced
    out._part._due = 0.0
    out.commit()
    # Here the power goes: nothing was closed.
    assert len(synced) == 1
    assert len(_frames(Recording(out.path).events())) == 1
    out.close()


@pytest.mark.parametrize("number", [1, 4, 7])
def test_a_changed_byte_ends_it_and_is_said(tmp_path, number):
    path = _written(tmp_path / "out", numbers=range(8), chunks=True).path
    whole, data = list(Recording(path).events()), bytearray(path.read_bytes())
    chunk = _chunks(path)[number]
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0x10
    path.write_bytes(data)
    recording = Recording(path)
    assert list(recording.events()) == whole[: 2 * number]
    assert "damaged" in recording.cut


def _chunks(path):
    with path.open("rb") as file:
        return make_reader(file).get_summary().chunk_indexes


def test_it_goes_on_in_new_files_and_deletes_the_oldest(tmp_path):
    out = parts(tmp_path / "out", Limits(part=30_000, keep=100_000, free=0))
    out.note("models", {"mug": "12"})
    for number in range(400):
        out.frame(*tiny_frame(number), KEY + "frame")
        out._part._due = 0.0
        out.commit()
    out.close()
    paths = sorted(tmp_path.iterdir())
    assert len(paths) > 2
    assert sum(path.stat().st_size for path in paths) < 100_000 + 30_000
    assert all(path.stat().st_size < 45_000 for path in paths)
    assert tmp_path / "out.mcap" not in paths
    recordings = [Recording(path) for path in paths]
    numbers = [header.frame_id for one in recordings for header, _, _ in _frames(one.events())]
    assert numbers == list(range(numbers[0], 400))
    # Each can be read by itself.
    assert [one.notes["models"] for one in recordings] == [{"mug": "12"}] * len(paths)
    assert out.size > 100_000
    assert out.frames == 400


def test_it_ends_before_the_disk_is_full(tmp_path):
    out = parts(tmp_path / "out", Limits(2**40, None, free=2**60))
    out.frame(*tiny_frame(0), KEY + "frame")
    out._part._due = 0.0
    with pytest.raises(DiskIsFull, match="are to be left"):
        out.commit()
    out.close()
    assert len(list(Recording(out.path).events())) == 1


def test_a_file_that_is_there_is_left_alone(tmp_path):
    (tmp_path / "out.mcap").write_text("mine")
    with pytest.raises(InputError, match="a file of that name"):
        parts(tmp_path / "out")
    assert (tmp_path / "out.mcap").read_text() == "mine"


def _mcap(path, **message):
    """A file with one message of another program."""
    message = {"topic": KEY + "pose/x/1", "encoding": "json", "data": b"{}"} | message
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(message["topic"], message["encoding"], 0)
        writer.add_message(channel, 1, message["data"], 1)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "data", [b"{}", b"nonsense", b"[]", b"\xff\xfe{}", b"[" * 100_000, b'{"quality": 1e999}']
)
def test_a_message_that_is_none_is_refused_with_its_key(tmp_path, data):
    path = _mcap(tmp_path / "x.mcap", data=data)
    with pytest.raises(InputError, match="pose/x/1"):
        list(Recording(path).events())


@pytest.mark.parametrize(
    ("topic", "encoding"), [("/odometry", "json"), (KEY + "pose/x/1", "cdr"), ("pose", "json")]
)
def test_what_other_programs_wrote_is_passed_over(tmp_path, topic, encoding):
    assert list(Recording(_mcap(tmp_path / "x.mcap", topic=topic, encoding=encoding)).events()) == []


def test_a_header_without_images_is_refused(tmp_path):
    header = msgspec.json.encode(EXAMPLES[FrameHeader])
    with pytest.raises(InputError, match="a frame without its images"):
        list(Recording(_mcap(tmp_path / "x.mcap", topic=KEY + "frame", data=header)).events())


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no recording at all", None])
def test_what_is_no_recording_is_refused(tmp_path, content, capsys):
    path = tmp_path / "x.mcap"
    path.mkdir() if content is None else path.write_bytes(content)
    for arguments in ([], ["--verify"], ["--bop", str(tmp_path / "bop")]):
        assert main(["replay", str(path), *arguments]) == 2
    assert str(path) in capsys.readouterr().err


def test_a_small_file_does_not_fill_the_memory(tmp_path):
    """A chunk that says it is larger than it is, and one that is larger than it may be."""
    import lz4.frame

    bomb = lz4.frame.compress(bytes(2**28))
    for size in (2**20, 2**40):
        body = (
            struct.pack("<QQQI", 1, 1, size, 0)
            + struct.pack("<I", 3)
            + b"lz4"
            + struct.pack("<Q", len(bomb))
            + bomb
        )
        path = tmp_path / f"{size}.mcap"
        path.write_bytes(b"\x89MCAP0\r\n" + b"\x06" + struct.pack("<Q", len(body)) + body)
        tracemalloc.start()
        recording = Recording(path)
        assert list(recording.events()) == []
        assert recording.cut
        assert tracemalloc.get_traced_memory()[1] < 2**24
        tracemalloc.stop()


def test_it_is_exported_as_a_bop_scene(tmp_path):
    out = parts(tmp_path / "out")
    truth = msgspec.structs.replace(EXAMPLES[TruthMessage], frame_id=8)
    for epoch, number in ((1, 7), (1, 8), (2, 3)):
        header, color, depth = tiny_frame(number)
        out.frame(msgspec.structs.replace(header, camera_epoch=epoch), color, depth, KEY + "frame")
        out.message(KEY + "truth", msgspec.structs.replace(truth, camera_epoch=epoch, frame_id=number))
    out.message(KEY + "pose/x/1", msgspec.structs.replace(POSE, camera_epoch=2, frame_id=3))
    out.close()
    folder = tmp_path / "bop"
    assert main(["replay", str(out.path), "--bop", str(folder)]) == 0
    scene = BopScene(folder)
    # The second opening of the camera goes on counting.
    assert scene.image_ids == (7, 8, 12)
    for image, number in ((7, 7), (8, 8), (12, 3)):
        header, color, depth = tiny_frame(number)
        frame = scene.frame(image)
        assert (frame.color == color).all()
        assert frame.depth == pytest.approx(depth * 0.0001, abs=1e-6)
        assert frame.stamp_ns == header.capture_ns
        assert (frame.camera.fx, frame.camera.cy) == (header.intrinsics.fx, header.intrinsics.cy)
        (label,) = scene.truths(image)
        assert label.T_cam_obj[:3, 3] == pytest.approx(truth.objects[0].translation)
        assert (label.object_id, label.visib_fract) == (
            truth.objects[0].object_id,
            truth.objects[0].visib_fract,
        )
    assert json.loads((folder / "poses.jsonl").read_text())["frame_id"] == 12
    with pytest.raises(InputError, match="a new or empty folder"):
        export_bop([], folder)


def test_it_is_a_camera(tmp_path):
    out = parts(tmp_path / "out")
    for number in (4, 4, 5):  # shown again, as the first frame of a recording is
        out.frame(*tiny_frame(number), KEY + "frame")
        out._part._due = 0.0
        out.commit()
    truth = msgspec.structs.replace(EXAMPLES[TruthMessage], frame_id=5)
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
        RecordedScene(_mcap(tmp_path / "x.mcap", topic="/other"))


class _Bus:
    """Keeps what is put."""

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
    player = Player(events, bus, 5_000_000_000, **options)
    due = []
    while not player.finished:
        due.append(player.due_ns())
        player.play()
    return bus.out, due


def test_it_is_played_in_order_with_its_ages_at_any_speed(tmp_path):
    events = list(Recording(_written(tmp_path / "out").path).events())
    out, due = _played(events[::-1], speed=2.0)
    assert [m.frame_id for _, m in out] == [7, 7, 8, 8, 12, 12]
    assert due[0] == 5_000_000_000
    assert due[2] - due[0] == pytest.approx(33_333_333 / 2, abs=1)
    assert [m.publish_ns for _, m in out] == due
    assert [m.publish_ns - m.capture_ns for _, m in out] == [
        e.message.publish_ns - e.message.capture_ns for e in in_order(events)
    ]
    assert {key for key, _ in out} == {"huepose/here/cam/frame", "huepose/here/cam/pose/x/1"}
    # One camera, which is not the recorded one.
    assert len({m.camera_epoch for _, m in out}) == 1
    assert out[0][1].camera_epoch != events[0].message.camera_epoch


@pytest.mark.parametrize(
    ("only", "keys"), [("camera", {"frame"}), ("tracker", {"pose/x/1"}), ("reinit", set())]
)
def test_one_worker_alone_is_played(tmp_path, only, keys):
    events = Recording(_written(tmp_path / "out").path).events()
    out, _ = _played(events, speed=1.0, only=only)
    assert {key.removeprefix("huepose/here/cam/") for key, _ in out} == keys


@pytest.mark.parametrize(
    ("tail", "worker"),
    [
        ("frame", "camera"),
        ("camera", "camera"),
        ("health/estimator", "estimator"),
        ("correction", "reinit"),
        ("perception/estimates", "estimator"),
        ("perception/request", "reinit"),
        ("tracker/intake", "tracker"),
    ],
)
def test_every_key_has_a_worker(tail, worker):
    assert said_by(KEY + tail) == worker


@pytest.mark.live
def test_a_camera_is_recorded_and_replayed(pipeline, scene, huepose, base_port, tmp_path):
    path = pipeline(once=False, rate=20)
    out = tmp_path / "recording.mcap"
    camera = huepose("run", "camera", path)
    recorder = huepose("record", out, "--config", path, "--free", "0")
    deadline = time.monotonic() + 60.0
    while not out.exists() or len(_frames(Recording(out).events())) < 20:
        assert time.monotonic() < deadline
        time.sleep(0.1)
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

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with Reader([endpoint(base_port)], "huepose/*/*/health/*") as reader:
        assert main(["replay", str(out), "--config", str(path), "--speed", "20", "--only", "camera"]) == 0
        assert reader.next(5.0).worker == "camera"
    for number, handler in before.items():
        signal.signal(number, handler)
