"""Bytes to messages and back: MessagePack maps, checked against the types, with caps on the size."""

from __future__ import annotations

from functools import cache
from typing import Any, TypeVar

import msgspec

from huepose_protos.fields import MAJOR, WireError
from huepose_protos.messages import Message

M = TypeVar("M", bound=Message)

_encoder = msgspec.msgpack.Encoder()


class _Versioned(msgspec.Struct):
    version: Any = None


_version_decoder = msgspec.msgpack.Decoder(_Versioned)


@cache
def _decoder(kind: type[M]) -> msgspec.msgpack.Decoder[M]:
    return msgspec.msgpack.Decoder(kind)


def encode(message: Message) -> bytes:
    """MessagePack of a message. Raises WireError over the size cap of its kind."""
    data = _encoder.encode(message)
    if len(data) > message.max_bytes:
        raise WireError(f"{type(message).__name__} of {len(data)} bytes is over {message.max_bytes}")
    return data


def decode(data: bytes, kind: type[M]) -> M:
    """The message of some bytes. Raises WireError, and nothing else, for bytes that are not one:
    over the size cap, truncated, of a wrong type or shape, out of range, not finite, not a rotation,
    of another major version."""
    if len(data) > kind.max_bytes:
        raise WireError(f"{kind.__name__} of {len(data)} bytes is over {kind.max_bytes}")
    try:
        message: M = _decoder(kind).decode(data)
    except (msgspec.MsgspecError, ValueError, OverflowError, RecursionError, MemoryError) as error:
        foreign = _foreign_version(data)
        raise WireError(foreign or f"{kind.__name__}: {_one_line(error)}") from None
    if int(message.version.split(".")[0]) != MAJOR:
        raise WireError(f"foreign version {message.version}, this is {MAJOR}.x")
    return message


def _foreign_version(data: bytes) -> str:
    """The error for bytes of another major version, the likely reason why they do not fit; else empty."""
    try:
        version = _version_decoder.decode(data).version
        major = int(str(version).split(".")[0])
    except (msgspec.MsgspecError, ValueError, OverflowError, RecursionError, MemoryError):
        return ""
    return f"foreign version {str(version)[:12]}, this is {MAJOR}.x" if major != MAJOR else ""


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def to_json(message: Message) -> str:
    """One line of JSON with the fields of the wire."""
    return msgspec.json.encode(message).decode()
