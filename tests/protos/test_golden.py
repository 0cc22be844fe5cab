"""The wire does not change by accident: bytes and schemas in the tree are those of the types."""

from pathlib import Path

import msgspec
import pytest

from huepose_protos import decode, encode
from huepose_protos.buffers import frame_images
from huepose_protos.examples import images, messages
from huepose_protos.export import files
from huepose_protos.messages import MESSAGES, FrameHeader

PROTOS = Path(__file__).parents[2] / "protos"
GOLDEN = PROTOS / "golden"


@pytest.mark.parametrize("name", sorted(files()))
def test_file_in_the_tree_is_the_one_that_the_types_give(name):
    assert (PROTOS / name).read_bytes() == files()[name], "run: python -m huepose_protos.export protos"


@pytest.mark.parametrize("message", messages(), ids=lambda m: type(m).__name__)
def test_golden_bytes_decode_to_the_example_and_back(message):
    data = (GOLDEN / f"{type(message).__name__}.bin").read_bytes()
    assert decode(data, type(message)) == message
    assert encode(decode(data, type(message))) == data


def test_there_is_an_example_of_every_message():
    assert {type(m) for m in messages()} == set(MESSAGES)


def test_golden_frame_payload_gives_the_images():
    header = decode((GOLDEN / "FrameHeader.bin").read_bytes(), FrameHeader)
    color, depth = frame_images(header, (GOLDEN / "frame_payload.bin").read_bytes())
    assert (color == images()["color"]).all()
    assert (depth == images()["depth"]).all()


def test_plain_messagepack_reads_the_same_map():
    import msgpack

    for message in messages():
        data = (GOLDEN / f"{type(message).__name__}.bin").read_bytes()
        assert msgpack.unpackb(data) == msgspec.msgpack.decode(data)
        assert list(msgpack.unpackb(data))[:2] == ["version", "publish_ns"]
