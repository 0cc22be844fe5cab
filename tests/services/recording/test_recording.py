"""A recording is read back exactly, also by other programs; however it ends, what was written stays."""

import errno
import json
import resource
import struct
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from huepose.support.errors import InputError
from huepose_protos import encode
from huepose_protos.examples import example
from huepose_protos.messages import FrameHeader, PoseMessage
from huepose_services.cli.main import main
from huepose_services.cli.record import _how_far
from huepose_services.recording.arrivals import Arrivals, Arrived
from huepose_services.recording.parts import DiskFullError, Limits
from huepose_services.recording.read import Recording
from huepose_services.recording.record import Span
from huepose_services.runtime.config import Config

from .conftest import KEY, UNIX_NS, chunks_of, frames, mcap_of, parts, tiny_frame, written

POSE = example(PoseMessage)


def test_what_is_written_is_read_back_exactly(tmp_path):
    out = written(tmp_path / "out")
    assert out.path == tmp_path / "out.mcap"
    assert out.size == out.path.stat().st_size
    recording = Recording(out.path)
    events = list(recording.events())
    assert (recording.cut, recording.exact) == ("", True)
    assert recording.notes["huepose"]["site"] == "a"
    for (header, color, depth), number in zip(frames(events), (7, 8, 12), strict=True):
        expected = tiny_frame(number)
        assert header == expected[0]
        assert (color == expected[1]).all()
        assert (depth == expected[2]).all()
    assert [e.message.frame_id for e in events] == [7, 7, 8, 8, 12, 12]
    assert {e.key for e in events} == {KEY + "frame", KEY + "pose/x/1"}
    assert msgspec.structs.replace(events[1].message, frame_id=42, publish_ns=POSE.publish_ns) == POSE


class _Came(Arrivals):
    """Twenty poses that came before the recorder took the first one."""

    def __init__(self, *_):
        super().__init__(MagicMock(), [], 2**20)
        for number in range(20):
            data = encode(msgspec.structs.replace(POSE, frame_id=number))
            self._waiting.append(Arrived("huepose/local/cam0/pose/x/1", data, b""))


@pytest.mark.parametrize(("second", "poses"), [(False, 20), (True, 0)])
def test_what_came_before_the_end_is_written_unless_ctrl_c_comes_again(tmp_path, monkeypatch, second, poses):
    stopped = [lambda: second, lambda: True]
    monkeypatch.setattr("huepose_services.cli.record.catch_stop_signals", stopped.pop)
    monkeypatch.setattr("huepose_services.recording.record.Arrivals", _Came)
    config = tmp_path / "pipeline.yaml"
    config.write_text("bus: {base_port: 29147}\nbundles: bundles\nobjects: [{name: cup}]\n")
    path = tmp_path / "out.mcap"
    assert main(["record", str(path), "--config", str(config)]) == (0 if poses else 1)
    events = Recording(path).events() if poses else []
    assert [event.message.frame_id for event in events] == list(range(poses))


def test_other_programs_read_a_recording_by_well_known_schemas(tmp_path):
    path = written(tmp_path / "out.mcap", numbers=(7,)).path
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
    tf = shown["/tf"][1]
    assert (tf.parent_frame_id, tf.child_frame_id) == ("cam0_color_optical", "006_mustard_bottle/3")
    encoding, schema, message = said[KEY + "pose/x/1"]
    assert (encoding, schema.encoding, schema.name) == ("json", "jsonschema", "PoseMessage")
    assert json.loads(schema.data)["type"] == "object"
    assert json.loads(message.data)["quality"] == POSE.quality


SHOWN = ["/cam0/color", "/cam0/depth", "/cam0/calibration", "/cam0/pose/006_mustard_bottle/3", "/tf"]


def test_a_recording_with_jpeg_says_that_it_is_not_exact(tmp_path):
    recording = Recording(written(tmp_path / "out", jpeg=True).path)
    for (_, color, depth), number in zip(frames(recording.events()), (7, 8, 12), strict=True):
        assert color.shape == (4, 6, 3)
        assert (depth == tiny_frame(number)[2]).all()
    assert not recording.exact


def test_a_recording_cut_at_any_byte_is_readable_up_to_the_last_whole_chunk(tmp_path):
    path = written(tmp_path / "out", numbers=range(8), chunks=True).path
    whole, data = list(Recording(path).events()), path.read_bytes()
    ends = [index.chunk_start_offset + index.chunk_length for index in chunks_of(path)]
    assert len(ends) == 8
    rng = np.random.default_rng(0)
    for cut in [*rng.integers(8, len(data), 60), *ends, ends[3] - 1]:
        path.write_bytes(data[:cut])
        recording = Recording(path)
        events = list(recording.events())
        # Two events in each chunk.
        assert events == whole[: 2 * sum(end <= cut for end in ends)]
        assert recording.cut == "it was cut off"


def test_every_chunk_is_on_the_disk_when_it_is_complete(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr("os.fdatasync", lambda number: synced.append(number))
    out = parts(tmp_path / "out")
    out.frame(*tiny_frame(0), KEY + "frame")
    out.commit()
    assert not synced
    out._due = 0.0
    out.commit()
    # As after a power failure: nothing was closed.
    assert len(synced) == 1
    assert len(frames(Recording(out.path).events())) == 1
    out.close()


def test_a_recording_that_has_just_begun_has_its_notes(tmp_path):
    out = parts(tmp_path / "out")
    recording = Recording(out.path)
    assert recording.notes["huepose"]["site"] == "a"
    assert list(recording.events()) == []
    out.close()


@pytest.mark.parametrize("number", [1, 4, 7])
def test_a_changed_byte_ends_the_reading_and_is_reported(tmp_path, number):
    path = written(tmp_path / "out", numbers=range(8), chunks=True).path
    whole, data = list(Recording(path).events()), bytearray(path.read_bytes())
    chunk = chunks_of(path)[number]
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0x10
    path.write_bytes(data)
    recording = Recording(path)
    assert list(recording.events()) == whole[: 2 * number]
    assert "damaged" in recording.cut


def test_a_recording_goes_on_in_new_files_and_deletes_the_oldest(tmp_path):
    out = parts(tmp_path / "out", Limits(part=30_000, keep=100_000, free=0))
    out.note("models", {"mug": "12"})
    _write_many(out)
    out.close()
    paths = sorted(tmp_path.iterdir())
    assert len(paths) > 2
    assert sum(path.stat().st_size for path in paths) < 100_000 + 30_000
    assert all(path.stat().st_size < 45_000 for path in paths)
    assert tmp_path / "out.mcap" not in paths
    recordings = [Recording(path) for path in paths]
    numbers = [header.frame_id for one in recordings for header, _, _ in frames(one.events())]
    assert numbers == list(range(numbers[0], 400))
    # Each can be read by itself.
    assert [one.notes["models"] for one in recordings] == [{"mug": "12"}] * len(paths)
    assert out.size > 100_000
    assert out.frames == 400
    said = _how_far(SimpleNamespace(missed=0, lost=0, span=Span()), out)
    assert said.startswith(f"{paths[0]} to {paths[-1].name}: 400 frames, "), "files that exist"


def test_a_recording_ends_before_the_disk_is_full(tmp_path):
    with pytest.raises(
        InputError, match=r"out\.mcap: found \d+ MiB are free on the disk, and \d+ must stay free"
    ):
        parts(tmp_path / "out", Limits(2**40, None, free=2**60))
    assert not list(tmp_path.iterdir())
    out = parts(tmp_path / "out")
    out._limits = Limits(2**40, None, free=2**60)
    out.frame(*tiny_frame(0), KEY + "frame")
    out._due = 0.0
    with pytest.raises(DiskFullError, match="must stay free"):
        out.commit()
    out.close()
    assert len(list(Recording(out.path).events())) == 1


def test_an_existing_file_is_not_overwritten(tmp_path):
    (tmp_path / "out.mcap").write_text("mine")
    with pytest.raises(InputError, match="a file of that name"):
        parts(tmp_path / "out")
    assert (tmp_path / "out.mcap").read_text() == "mine"


def test_on_a_full_disk_no_empty_file_is_left(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        with pytest.raises(InputError, match=r"out\.mcap: found File too large; expected a new file"):
            parts(tmp_path / "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("left", "taken"), [("out_0003.mcap", True), ("out_20260101.mcap", False)])
def test_a_part_of_another_recording_is_refused_at_the_start(tmp_path, left, taken):
    (tmp_path / left).write_text("mine")
    if taken:
        with pytest.raises(InputError, match=r"out_0003\.mcap: found a part of another recording"):
            parts(tmp_path / "out")
    else:
        parts(tmp_path / "out").close()
    assert (tmp_path / left).read_text() == "mine"
    assert (tmp_path / "out.mcap").exists() != taken


def _write_many(out):
    """Writes frames until the next file is due."""
    for number in range(400):
        out.frame(*tiny_frame(number), KEY + "frame")
        out._due = 0.0
        out.commit()


@pytest.mark.parametrize("refusal", [None, errno.ENOSPC])
def test_if_the_next_file_cannot_be_made_what_was_written_stays(tmp_path, monkeypatch, refusal):
    """Another program has made a file of that name, or the disk has no room for one."""
    out = parts(tmp_path / "out", Limits(part=30_000, keep=None, free=0))
    (tmp_path / "out_0001.mcap").write_text("mine")

    def refused(*_):
        raise OSError(refusal, "refused")

    if refusal is not None:
        monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(OSError, match="File exists" if refusal is None else "refused"):
        _write_many(out)
    monkeypatch.undo()
    out.close()
    assert out.paths == [tmp_path / "out.mcap"]
    assert out.size == out.path.stat().st_size
    assert len(frames(Recording(out.path).events())) == out.frames
    assert (tmp_path / "out_0001.mcap").read_text() == "mine"


def test_what_was_recorded_is_never_deleted(tmp_path, monkeypatch, capsys):
    class Recorder:
        finished, missed, lost = "", 0, 0

        def __init__(self, bus, out, with_frames):
            self.out, self.span = out, Span()

        def step(self, timeout_s):
            self.out.frame(*tiny_frame(0), KEY + "frame")
            self.span.saw(1, 1)
            (tmp_path / "out_0001.mcap").write_text("mine")
            self.out._limits = Limits(1, None, 0)
            self.out._due = 0.0
            self.out.commit()

        def close(self):
            pass

    monkeypatch.setattr("huepose_services.recording.record.Recorder", Recorder)
    monkeypatch.setattr("huepose_services.runtime.session.open_recorder_session", lambda config: MagicMock())
    monkeypatch.setattr("huepose_services.runtime.worker.come_first", lambda name: None)
    monkeypatch.setattr("huepose_services.cli.record.catch_stop_signals", lambda: lambda: False)
    monkeypatch.setattr("huepose_services.cli.record.chosen_config", lambda _: (Config(), True))
    monkeypatch.setattr("huepose_services.cli.record.wait_for_pipeline", lambda *_: False)
    assert main(["record", str(tmp_path / "out"), "--free", "0"]) == 1
    assert "File exists; what was written is kept" in capsys.readouterr().err
    assert len(frames(Recording(tmp_path / "out.mcap").events())) == 1


def test_a_video_is_refused_with_what_to_record_instead(tmp_path):
    video = tmp_path / "turned.MP4"
    video.write_bytes(b"\0\0\0\x20ftypisom")
    with pytest.raises(InputError, match=r"another kind of file; .* video has no depth, .*`huepose record`"):
        Recording(video)


@pytest.mark.parametrize(
    "data", [b"{}", b"nonsense", b"[]", b"\xff\xfe{}", b"[" * 100_000, b'{"quality": 1e999}']
)
def test_an_invalid_message_is_refused_with_its_key(tmp_path, data):
    path = mcap_of(tmp_path / "x.mcap", data=data)
    with pytest.raises(InputError, match="pose/x/1"):
        list(Recording(path).events())


@pytest.mark.parametrize(
    ("topic", "encoding"), [("/odometry", "json"), (KEY + "pose/x/1", "cdr"), ("pose", "json")]
)
def test_messages_of_other_programs_are_skipped(tmp_path, topic, encoding):
    assert list(Recording(mcap_of(tmp_path / "x.mcap", topic=topic, encoding=encoding)).events()) == []


def test_a_header_without_images_is_refused(tmp_path):
    header = msgspec.json.encode(example(FrameHeader))
    with pytest.raises(InputError, match="a frame without its images"):
        list(Recording(mcap_of(tmp_path / "x.mcap", topic=KEY + "frame", data=header)).events())


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no recording at all", None])
def test_a_file_that_is_no_recording_is_refused(tmp_path, content, refused):
    path = tmp_path / "x.mcap"
    path.mkdir() if content is None else path.write_bytes(content)
    for arguments in ([], ["--verify"], ["--bop", str(tmp_path / "bop")]):
        said = refused(["replay", path, *arguments])
        assert said.startswith(f"huepose replay: {path}: found"), "before anything is begun"
        assert said.count("\n") == 1
    assert not (tmp_path / "bop").exists()


def test_a_recording_without_frames_is_no_scene(tmp_path, capsys):
    path = mcap_of(tmp_path / "x.mcap", data=msgspec.json.encode(POSE))
    assert main(["replay", str(path), "--bop", str(tmp_path / "bop")]) == 1
    assert "the recording has no frames" in capsys.readouterr().err


def test_a_small_file_does_not_fill_the_memory(tmp_path):
    """A chunk that is larger than it says, and one that says more than is allowed."""
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


def test_frames_from_before_the_recording_do_not_count_as_recorded_time():
    span, second = Span(), 1_000_000_000
    assert (span.seconds, span.before_s) == (0.0, 0.0)
    span.saw(99_990_000_000, 100 * second)
    span.saw(98_200_000_000, 101 * second, asked_for=True)
    span.saw(100_500_000_000, 102 * second, asked_for=True)  # a frame that was lost on the way
    span.saw(114 * second, 114 * second)
    assert span.older == 1
    assert span.seconds == pytest.approx(14.0)
    assert span.before_s == pytest.approx(1.8)
