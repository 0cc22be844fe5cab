"""One example of every message, with known numbers: `golden/NAME.json`, of which the bytes there are made."""

from __future__ import annotations

from pathlib import Path

import msgspec

from huepose_protos.buffers import Array, unpack
from huepose_protos.messages import MESSAGES, FrameHeader, Message

GOLDEN = Path(__file__).parent / "golden"


def messages() -> list[Message]:
    """One of each kind, a frame first."""
    return [example(kind) for kind in MESSAGES]


def example(kind: type[Message]) -> Message:
    """The one of a kind."""
    return msgspec.json.decode((GOLDEN / f"{kind.__name__}.json").read_bytes(), type=kind)


def images() -> dict[str, Array]:
    """The buffers of the example frame: color (2, 4, 3), depth (2, 4)."""
    frame = example(FrameHeader)
    assert isinstance(frame, FrameHeader)
    return unpack(frame.buffers, (GOLDEN / "frame_payload.bin").read_bytes())
