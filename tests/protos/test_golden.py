"""The wire format does not change by accident: bytes and schemas in the repository are those of the types."""

import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from huepose_protos import WireError, decode, encode
from huepose_protos import messages as wire
from huepose_protos.buffers import frame_images
from huepose_protos.examples import GOLDEN, example, messages
from huepose_protos.export import files
from huepose_protos.fields import MAJOR, MINOR
from huepose_protos.messages import MESSAGES, FrameHeader, Message

PROTOS = Path(__file__).parents[2] / "protos"


@pytest.mark.parametrize("name", sorted(files()))
def test_each_file_in_the_repository_is_what_the_types_generate(name):
    assert (PROTOS / name).read_bytes() == files()[name], "run: python -m huepose_protos.export protos"


@pytest.mark.parametrize("message", messages(), ids=lambda m: type(m).__name__)
def test_golden_bytes_decode_to_the_example_and_back(message):
    data = (GOLDEN / f"{type(message).__name__}.bin").read_bytes()
    assert decode(data, type(message)) == message
    assert encode(decode(data, type(message))) == data


def test_every_message_of_the_wire_has_an_example_and_nothing_else_has():
    kinds = {kind for kind in vars(wire).values() if isinstance(kind, type) and issubclass(kind, Message)}
    assert kinds - {Message} == set(MESSAGES)
    assert {path.stem for path in GOLDEN.iterdir()} == {k.__name__ for k in MESSAGES} | {"frame_payload"}
    assert {path.stem for path in (PROTOS / "schemas").iterdir()} == {k.__name__ for k in MESSAGES}


def test_golden_frame_payload_gives_the_images():
    header = decode((GOLDEN / "FrameHeader.bin").read_bytes(), FrameHeader)
    color, depth = frame_images(header, (GOLDEN / "frame_payload.bin").read_bytes())
    assert color.tolist() == np.arange(24).reshape(2, 4, 3).tolist()
    assert depth.tolist() == [[0, 1000, 2000, 3000], [4000, 5000, 6000, 7000]]


def test_plain_messagepack_reads_the_same_map():
    import msgpack

    for message in messages():
        data = (GOLDEN / f"{type(message).__name__}.bin").read_bytes()
        assert msgpack.unpackb(data) == msgspec.msgpack.decode(data)
        assert list(msgpack.unpackb(data))[:2] == ["version", "publish_ns"]


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
def test_the_manual_names_every_message_and_every_field(kind):
    page = (PROTOS / "README.md").read_text()
    named = set(re.findall(r"`([a-z_]+)`", page))
    _, parts = msgspec.json.schema_components([kind])
    fields = {name for part in parts.values() for name in part.get("properties", {})}
    assert f"**{kind.__name__}**" in page
    assert fields <= named, fields - named


def test_an_older_reader_takes_a_newer_minor_and_refuses_a_newer_major_by_name():
    """A message with an unknown field."""
    pose = example(wire.PoseMessage)
    newer = {**msgspec.to_builtins(pose), "grip_width_m": 0.08}
    minor = msgspec.msgpack.encode({**newer, "version": f"{MAJOR}.{MINOR + 1}"})
    assert msgspec.structs.replace(decode(minor, type(pose)), version=pose.version) == pose
    major = msgspec.msgpack.encode({**newer, "version": f"{MAJOR + 1}.0"})
    with pytest.raises(WireError, match=f"foreign version {MAJOR + 1}.0, this is {MAJOR}.x"):
        decode(major, type(pose))


def test_fields_that_came_later_may_be_missing():
    """A newer reader takes what an older writer of the same major sends."""
    late = {"locked_mib", "drops", "errors", "last_error", "restarts", "picture"}
    health = example(wire.HealthMessage)
    older = {name: value for name, value in msgspec.to_builtins(health).items() if name not in late}
    assert decode(msgspec.msgpack.encode(older), type(health)).drops == 0
