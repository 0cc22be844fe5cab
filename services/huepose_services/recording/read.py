"""Reads a recording from its beginning to its end, or to where it was cut off. It raises InputError only."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import cv2
import lz4.frame
import msgspec
import numpy as np
import zstandard
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Footer, Header, Metadata
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from huepose.datasets.files import instead_of_film
from huepose.support.errors import InputError
from huepose.support.picture_size import picture_size
from huepose_protos import WireError
from huepose_protos.buffers import Array, frame_images, pack
from huepose_protos.client import kind_of
from huepose_protos.messages import FrameHeader, Message
from huepose_services.recording.parts import COLOR, DEPTH

_MAX_RECORD = 256 * 1024 * 1024
"""Bytes of a chunk, before and after it is unpacked: a small file must not fill the memory."""

_BROKEN = (McapError, struct.error, ValueError, OverflowError, MemoryError)
"""What the reader of MCAP raises for a file that is cut off or damaged."""


@dataclass(frozen=True)
class Event:
    """A message with the key that it had on the wire; `payload`: the pixels of a FrameHeader."""

    key: str
    message: Message
    payload: bytes = b""


def is_of_ros(path: Path) -> bool:
    """Whether an MCAP file has the profile of ROS 2. False if it is missing or broken."""
    try:
        with path.open("rb") as file:
            first = next(iter(StreamReader(file, record_size_limit=_MAX_RECORD).records), None)
    except (OSError, *_BROKEN):
        return False
    return isinstance(first, Header) and first.profile == "ros2"


class Recording:
    """`events()` gives all events, in the order in which they were written. Afterwards `cut` says why the
    file ended early (empty: it did not), and `notes` has the notes about the recording, by subject. Raises
    InputError at once for a file that is no recording."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.cut = self._damage = ""
        self.notes: dict[str, dict[str, str]] = {}
        self._channels: dict[int, Channel] = {}
        self._images: dict[str, McapMessage] = {}
        next(self.chunks(), None)

    @property
    def exact(self) -> bool:
        """Whether its images are exactly those that the pipeline had."""
        return self.notes.get("huepose", {}).get("color") == "exact"

    def events(self) -> Iterator[Event]:
        """Frames and messages. Raises InputError for a file that is no recording, or has wrong messages in
        it."""
        for _, chunk in self.chunks():
            yield from self.inside(chunk)

    def chunks(self) -> Iterator[tuple[int, Chunk]]:
        """Complete chunks, with their positions in the file."""
        try:
            with self.path.open("rb") as file:
                yield from self._chunks(file)
        except OSError as error:
            raise InputError(
                self.path,
                found="a folder" if self.path.is_dir() else error.strerror or str(error),
                expected="a recording (.mcap)",
                fix="`huepose record FILE` makes one.",
            ) from None

    def _chunks(self, file: BinaryIO) -> Iterator[tuple[int, Chunk]]:
        self.cut, self._damage = "it was cut off", ""
        begins = file.read(len(MCAP0_MAGIC))
        if begins != MCAP0_MAGIC:
            found = "another kind of file" if begins else "an empty file"
            fix = instead_of_film(self.path)
            raise InputError(self.path, found=found, expected="a recording (.mcap)", fix=fix)
        place = file.tell()
        reader = StreamReader(file, skip_magic=True, emit_chunks=True, record_size_limit=_MAX_RECORD)
        try:
            for record in reader.records:
                if isinstance(record, Chunk):
                    yield place, record
                    if self._damage:
                        self.cut = self._damage
                        return
                elif isinstance(record, Metadata):
                    self.notes[record.name] = self.notes.get(record.name, {}) | record.metadata
                elif isinstance(record, Footer):
                    self.cut = ""
                place = file.tell()
        except _BROKEN:
            return  # the rest is no complete record

    def chunk(self, place: int) -> Chunk:
        """The chunk at a position that `chunks` gave."""
        try:
            with self.path.open("rb") as file:
                file.seek(place)
                reader = StreamReader(file, skip_magic=True, emit_chunks=True, record_size_limit=_MAX_RECORD)
                record = next(iter(reader.records), None)
        except (OSError, *_BROKEN):
            record = None
        if not isinstance(record, Chunk):
            raise self.changed()
        return record

    def changed(self) -> InputError:
        """The error for a file that is not the one that `chunks` has read."""
        return InputError(self.path, found="another file than before", expected="that it stays as it is")

    def inside(self, chunk: Chunk, pixels: bool = True) -> Iterator[Event]:
        """The events in a chunk; none if the chunk is damaged. pixels False: headers only."""
        try:
            records = breakup_chunk(_unpacked(chunk), validate_crc=True)
        except (McapError, RuntimeError, zstandard.ZstdError, struct.error, ValueError) as error:
            self._damage = f"it is damaged: {error}"
            return
        for record in records:
            if isinstance(record, Channel):
                self._channels[record.id] = record
            elif isinstance(record, McapMessage):
                channel = self._channels.get(record.channel_id)
                event = None if channel is None else self._event(channel, record, pixels)
                if event is not None:
                    yield event

    def _event(self, channel: Channel, record: McapMessage, pixels: bool) -> Event | None:
        topic = channel.topic
        if channel.message_encoding == "protobuf":
            if topic.endswith((f"/{COLOR}", f"/{DEPTH}")):
                self._images[topic.rsplit("/", 1)[1]] = record
            return None
        kind = FrameHeader if topic.endswith("/frame") else kind_of(topic)
        if kind is None or channel.message_encoding != "json" or topic.count("/") < 3:
            return None  # another program may have added it
        try:
            message = msgspec.json.decode(record.data, type=kind)
            if not (pixels and isinstance(message, FrameHeader)):
                return Event(topic, message)
            return self._frame(topic, message, record.sequence)
        except (
            msgspec.MsgspecError,
            WireError,
            DecodeError,
            ValueError,
            RecursionError,
            OverflowError,
        ) as error:
            raise InputError(
                f"{self.path}: {topic}",
                found=str(error)[:200] or type(error).__name__,
                expected=kind.__name__,
            ) from None

    def _frame(self, key: str, header: FrameHeader, sequence: int) -> Event:
        """A frame from its header; its images came right before."""
        images = {name: one for name, one in self._images.items() if one.sequence == sequence}
        if set(images) != {COLOR, DEPTH}:
            raise ValueError("a frame without its images")
        i = header.intrinsics
        color = _color(images[COLOR].data, self.exact, (i.height, i.width))
        depth = _pixels(images[DEPTH].data, np.dtype("<u2"), (i.height, i.width))
        buffers, payload = pack({COLOR: color, DEPTH: depth})
        header = msgspec.structs.replace(header, buffers=buffers)
        frame_images(header, payload)
        return Event(key, header, payload)


def _unpacked(chunk: Chunk) -> Chunk:
    size = chunk.uncompressed_size
    if size > _MAX_RECORD:
        raise ValueError(f"a chunk of {size} bytes")
    if chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression[:20]!r}")
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("a chunk is not what was written")
    chunk.compression, chunk.data = "", data
    return chunk


def _color(data: bytes, exact: bool, size: tuple[int, int]) -> Array:
    if exact:
        return _pixels(data, np.dtype(np.uint8), (*size, 3))
    jpeg = CompressedImage.FromString(data).data
    width, height = picture_size(jpeg) or (0, 0)
    if (height, width) != size:
        raise ValueError(f"an image of {width} x {height}, not {size[1]} x {size[0]}")
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError("no image that can be decoded")
    return np.ascontiguousarray(image[..., ::-1])


def _pixels(data: bytes, dtype: np.dtype, shape: tuple[int, ...]) -> Array:
    return np.frombuffer(RawImage.FromString(data).data, dtype).reshape(shape)
