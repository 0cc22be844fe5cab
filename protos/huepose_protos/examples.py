"""One example of every message, with known numbers: `golden/NAME.json`, from which `NAME.bin` is made."""

from __future__ import annotations

from pathlib import Path

import msgspec

from huepose_protos.buffers import Array, unpack
from huepose_protos.codec import M
from huepose_protos.messages import MESSAGES, FrameHeader, Message

GOLDEN = Path(__file__).parent / "golden"


def messages() -> list[Message]:
    """One example of each kind, a frame first."""
    return [example(kind) for kind in MESSAGES]


def example(kind: type[M]) -> M:
    """The example of a kind."""
    return msgspec.json.decode((GOLDEN / f"{kind.__name__}.json").read_bytes(), type=kind)


def images() -> dict[str, Array]:
    """The buffers of the example frame: color (2, 4, 3), depth (2, 4)."""
    return unpack(example(FrameHeader).buffers, (GOLDEN / "frame_payload.bin").read_bytes())
