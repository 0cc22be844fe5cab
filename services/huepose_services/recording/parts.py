"""A recording as files one after the other, each of limited size, all together too, on a disk that is not
filled."""

from __future__ import annotations

import shutil
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from huepose.support.errors import InputError
from huepose_protos.buffers import Array
from huepose_protos.messages import FrameHeader, Message
from huepose_services.recording.part import Part

SUFFIX = ".mcap"
_LOOK_EVERY_S = 1.0


@dataclass(frozen=True)
class Limits:
    """In bytes: of one file, of all together (None: no limit; else the oldest files are deleted), and what is
    left free on the disk."""

    part: int
    keep: int | None
    free: int


class DiskFullError(OSError):
    """There is not more free than is to be left."""


class Parts:
    """Takes what a Part takes. `name.mcap` first, then `name_0001.mcap` and so on.

    Raises InputError for a file that is there already or cannot be made, OSError for a disk that is full."""

    def __init__(self, path: Path, limits: Limits, offset_ns: int, about: dict[str, str], jpeg: bool) -> None:
        self.path = path if path.suffix == SUFFIX else path.with_name(path.name + SUFFIX)
        self._limits, self._offset_ns, self._jpeg = limits, offset_ns, jpeg
        self._about = about | {"color": "jpeg" if jpeg else "exact"}
        self._notes: dict[str, dict[str, str]] = {}
        self._done: deque[tuple[Path, int]] = deque()
        self._number = self.frames = self._bytes_done = 0
        self._look_at = 0.0
        self._part = self._begin()

    @property
    def size(self) -> int:
        """Bytes of all files, with those that were deleted since."""
        return self._bytes_done + self._part.size

    def _begin(self) -> Part:
        number = f"_{self._number:04d}" if self._number else ""
        path = self.path.with_name(f"{self.path.stem}{number}{SUFFIX}")
        try:
            part = Part(path, self._offset_ns, self._about | {"part": str(self._number)}, self._jpeg)
        except FileExistsError:
            raise InputError(path, found="a file of that name", expected="a new one") from None
        except OSError as error:
            if self._number:
                raise
            raise InputError(path, found=error.strerror or str(error), expected="a new file") from None
        for name, values in self._notes.items():
            part.note(name, values)
        return part

    def note(self, name: str, values: dict[str, str]) -> None:
        """Something about the recording itself, for this file and those to come."""
        self._notes[name] = self._notes.get(name, {}) | values
        self._part.note(name, values)

    def frame(self, header: FrameHeader, color: Array, depth: Array, key: str) -> None:
        """A frame."""
        self._part.frame(header, color, depth, key)
        self.frames += 1

    def message(self, key: str, message: Message) -> None:
        """A message without pixels."""
        self._part.message(key, message)

    def commit(self) -> None:
        """Make what is complete last, begin a new file and delete old ones where it is time. Raises
        DiskFullError before the disk is."""
        if not self._part.commit():
            return
        if time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LOOK_EVERY_S
            free = shutil.disk_usage(self.path.parent).free
            if free < self._limits.free:
                left = self._limits.free >> 20
                raise DiskFullError(
                    f"{free >> 20} MiB are free on the disk, and {left} are to be left (--free)"
                )
        if self._part.size >= self._limits.part:
            self.close()
            self._done.append((self._part.path, self._part.size))
            self._bytes_done += self._part.size
            self._number += 1
            self._part = self._begin()
        kept = sum(size for _, size in self._done) + self._part.size
        while self._limits.keep is not None and self._done and kept > self._limits.keep:
            path, size = self._done.popleft()
            path.unlink(missing_ok=True)
            kept -= size

    def close(self) -> None:
        """Write the rest."""
        self._part.close()
