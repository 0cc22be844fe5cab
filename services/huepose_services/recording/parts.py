"""Writes a recording in MCAP (mcap.dev): a series of files, with limits for the size of each, for the size
of all, and for the free space on the disk.

Each file can be read by itself, here and in Foxglove and rerun. Our own messages are stored as JSON with
their schemas, under their keys. Images, poses and intrinsics are stored for viewers as well, in Foxglove's
messages, under the camera's name. A frame is three messages with the same sequence number: colour, depth,
and last its header.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import Any

import cv2
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from huepose.support.errors import InputError
from huepose_protos import to_json
from huepose_protos.buffers import Array
from huepose_protos.export import json_schema
from huepose_protos.keys import camera_of
from huepose_protos.messages import FrameHeader, Message, PoseMessage

COLOR, DEPTH = "color", "depth"
GIVEN = "tracker/frame"
"""The end of the key of frames that the tracker gave on request: late, and some from before the recording."""
JPEG_QUALITY = 90
SUFFIX = ".mcap"
_LOOK_EVERY_S = 1.0
_CHUNK_BYTES, _CHUNK_S = 8 * 1024 * 1024, 0.5
"""A chunk is written to the disk when it is this large, or this old; what came after it may be lost."""


@dataclass(frozen=True)
class Limits:
    """In bytes: of one file, of all together (None: no limit; else the oldest files are deleted), and the
    space that stays free on the disk."""

    part: int
    keep: int | None
    free: int


class DiskFullError(OSError):
    """The disk has less free space than `Limits.free`."""


class Parts:
    """Takes frames and messages; `commit` writes them to the disk when it is time. The files are `name.mcap`,
    `name_0001.mcap` and so on. offset_ns: from timestamps to Unix time; about: notes for each file.

    Raises InputError if the first file cannot be made, or it or a later one exists already. All methods raise
    OSError if the disk does not accept the data."""

    def __init__(self, path: Path, limits: Limits, offset_ns: int, about: dict[str, str], jpeg: bool) -> None:
        self.path = path if path.suffix == SUFFIX else path.with_name(path.name + SUFFIX)
        self._path = self.path
        self._limits, self._offset_ns, self._jpeg = limits, offset_ns, jpeg
        self._notes = {"huepose": about | {"color": "jpeg" if jpeg else "exact"}}
        self._done: deque[tuple[Path, int]] = deque()
        self._number = self.frames = self._bytes_done = 0
        self._look_at = 0.0
        later = f"{escape(self.path.stem)}_[0-9][0-9][0-9][0-9]{SUFFIX}"
        if left := sorted(self.path.parent.glob(later)):
            raise InputError(
                left[0],
                found="a part of another recording",
                expected="none: this one would go on in that file",
                fix="Move it away, or record under another name.",
            )
        self._begin()

    def _begin(self) -> None:
        """Begin the next file."""
        number = f"_{self._number:04d}" if self._number else ""
        path = self.path.with_name(f"{self.path.stem}{number}{SUFFIX}")
        file = None
        try:
            self._check_free()
            file = path.open("xb")
            if self._number:  # the file before is complete
                self._done.append((self._path, self._size))
                self._bytes_done += self._size
            self._path, self._file, self._closed_at = path, file, 0
            self._channels: dict[str, int] = {}
            self._schemas: dict[type, int] = {}
            self._pending, self._due = 0, time.monotonic() + _CHUNK_S
            # LZ4 takes a third of the time of zstd, and most of the data are images.
            self._writer = Writer(self._file, chunk_size=2**40, compression=CompressionType.LZ4)
            self._writer.start(library="huepose")
            self._notes["huepose"]["part"] = str(self._number)
            for name, values in self._notes.items():
                self._writer.add_metadata(name, values)
            self._writer.flush()  # so that the notes are in the file from the beginning
        except OSError as error:
            if self._number:
                raise
            there = isinstance(error, FileExistsError)
            if file is not None:  # there is nothing in it yet
                path.unlink()
                with suppress(OSError):
                    file.close()
            found = "a file of that name" if there else error.strerror or str(error)
            raise InputError(path, found=found, expected="a new file, in a folder with room") from None

    @property
    def _size(self) -> int:
        """Bytes of this file on the disk."""
        return self._file.tell() if not self._file.closed else self._closed_at

    @property
    def size(self) -> int:
        """Bytes of all files, including those that were deleted since."""
        return self._bytes_done + self._size

    @property
    def paths(self) -> list[Path]:
        """The files that were not deleted since, in order."""
        return [*(path for path, _ in self._done), self._path]

    def note(self, name: str, values: dict[str, str]) -> None:
        """Add a note about the recording itself, to this file and later ones."""
        self._notes[name] = self._notes.get(name, {}) | values
        self._writer.flush()
        self._writer.add_metadata(name, values)

    def frame(self, header: FrameHeader, color: Array, depth: Array, key: str) -> None:
        """Add a frame; key: under which it came."""
        stamps = (header.capture_ns, header.publish_ns)
        camera, name, at = camera_of(key), header.frame, self._time(header.capture_ns)
        i = header.intrinsics
        calibration = CameraCalibration(timestamp=at, frame_id=name, width=i.width, height=i.height)
        calibration.K[:] = [i.fx, 0.0, i.cx, 0.0, i.fy, i.cy, 0.0, 0.0, 1.0]
        calibration.R[:] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
        calibration.P[:] = [i.fx, 0.0, i.cx, 0.0, 0.0, i.fy, i.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
        self._add_for_viewers(f"/{camera}/calibration", calibration, *stamps)
        if self._jpeg:
            bgr = cv2.cvtColor(color, cv2.COLOR_RGB2BGR)
            data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
            image: Any = CompressedImage(timestamp=at, frame_id=name, data=data, format="jpeg")
        else:
            image = _raw(at, name, color, "rgb8")
        self._add_for_viewers(f"/{camera}/{COLOR}", image, *stamps)
        self._add_for_viewers(f"/{camera}/{DEPTH}", _raw(at, name, depth, "16UC1"), *stamps)
        self._add_own(key, header, *stamps)
        self.frames += 1

    def message(self, key: str, message: Message) -> None:
        """Add a message without pixels."""
        stamp_ns = message.publish_ns
        self._add_own(key, message, stamp_ns, stamp_ns)
        if isinstance(message, PoseMessage) and message.translation and message.quaternion:
            camera, at = camera_of(key), self._time(message.capture_ns)
            name = f"{message.object}/{message.instance}"
            t = Vector3(**dict(zip("xyz", message.translation, strict=True)))
            q = Quaternion(**dict(zip("xyzw", message.quaternion, strict=True)))
            pose = PoseInFrame(timestamp=at, frame_id=message.frame)
            pose.pose.position.CopyFrom(t)
            pose.pose.orientation.CopyFrom(q)
            transform = FrameTransform(
                timestamp=at, parent_frame_id=message.frame, child_frame_id=name, translation=t, rotation=q
            )
            for topic, shown in ((f"/{camera}/pose/{name}", pose), ("/tf", transform)):
                self._add_for_viewers(topic, shown, message.capture_ns, stamp_ns)

    def _time(self, stamp_ns: int) -> Timestamp:
        at = Timestamp()
        at.FromNanoseconds(stamp_ns + self._offset_ns)
        return at

    def _add_own(self, key: str, message: Message, stamp_ns: int, publish_ns: int) -> None:
        self._open(key, "json", type(message))
        self._add(key, to_json(message).encode(), stamp_ns, publish_ns)

    def _add_for_viewers(self, topic: str, shown: Any, stamp_ns: int, publish_ns: int) -> None:
        self._open(topic, "protobuf", type(shown))
        self._add(topic, shown.SerializeToString(), stamp_ns, publish_ns)

    def _open(self, topic: str, encoding: str, kind: type) -> None:
        """Make a channel for messages of a kind, if it does not exist yet."""
        if topic in self._channels:
            return
        if kind not in self._schemas and encoding == "json":
            schema = json.dumps({"type": "object"} | json_schema(kind)).encode()
            self._schemas[kind] = self._writer.register_schema(kind.__name__, "jsonschema", schema)
        elif kind not in self._schemas:
            self._schemas[kind] = register_schema(self._writer, kind)
        self._channels[topic] = self._writer.register_channel(topic, encoding, self._schemas[kind])

    def _add(self, topic: str, data: bytes, stamp_ns: int, publish_ns: int) -> None:
        offset_ns = self._offset_ns
        self._writer.add_message(
            self._channels[topic],
            log_time=stamp_ns + offset_ns,
            data=data,
            publish_time=publish_ns + offset_ns,
            sequence=self.frames % 2**32,
        )
        self._pending += len(data)

    def commit(self) -> None:
        """If it is time, end the chunk and wait until it is on the disk; begin a new file and delete old
        ones if necessary. Raises DiskFullError before the disk is full."""
        if not self._pending or (self._pending < _CHUNK_BYTES and time.monotonic() < self._due):
            return
        self._writer.flush()
        os.fdatasync(self._file.fileno())
        self._pending, self._due = 0, time.monotonic() + _CHUNK_S
        if time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LOOK_EVERY_S
            self._check_free()
        if self._size >= self._limits.part:
            self.close()
            self._number += 1
            self._begin()
        kept = sum(size for _, size in self._done) + self._size
        while self._limits.keep is not None and self._done and kept > self._limits.keep:
            path, size = self._done.popleft()
            path.unlink(missing_ok=True)
            kept -= size

    def _check_free(self) -> None:
        free, left = shutil.disk_usage(self.path.parent).free, self._limits.free
        if free < left:
            raise DiskFullError(
                f"{free >> 20} MiB are free on the disk, and {left >> 20} must stay free (--free)"
            )

    def close(self) -> None:
        """Write all that is left, and the index; nothing if that is done already."""
        if self._file.closed:
            return
        try:
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
        finally:
            try:
                self._file.close()  # fails as well on a full disk
            finally:
                self._closed_at = self._path.stat().st_size


def _raw(at: Timestamp, name: str, image: Array, encoding: str) -> RawImage:
    height, width = image.shape[:2]
    step = image.nbytes // height
    return RawImage(
        timestamp=at,
        frame_id=name,
        width=width,
        height=height,
        encoding=encoding,
        step=step,
        data=image.tobytes(),
    )
