"""The file that a computed loop is kept in: pictures one after another, an index of them at the end.

Colour is JPEG (as most cameras deliver it), depth raw uint16, so that playing it costs little. A file is
written beside its name and moved there when complete; on opening, everything is checked, and whoever asked
computes the loop anew when it does not hold.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, UInt8, UInt16
from huepose.support.errors import InputError
from huepose.support.files import whole, writing

MAGIC = b"HUELOOP1"
DEPTH_SCALE_M = 1e-4
_ALIGN = 16
_END = 24
"""Bytes after the table: its length, the checksum of all before, and MAGIC."""
_CHUNK = 1024 * 1024


@dataclass(frozen=True, eq=False)
class Loop:
    """An opened loop: `facts` as they were stored, and the pictures. These are read, not mapped: a loop that
    is played would lie whole in the process's memory."""

    facts: dict[str, Any]
    _path: Path
    _index: list[tuple[int, int, int]]
    _size: tuple[int, int]

    def __len__(self) -> int:
        return len(self._index)

    def color(self, i: int) -> UInt8:
        """Colour (H, W, 3) uint8 RGB."""
        at, length, _ = self._index[i]
        image = cv2.imdecode(self._read(at, length), cv2.IMREAD_COLOR_RGB)
        assert image is not None
        return np.asarray(image, np.uint8)

    def depth(self, i: int) -> Float32:
        """Depth (H, W) float32 metres, 0 = none."""
        at = self._index[i][2]
        height, width = self._size
        raw: UInt16 = self._read(at, 2 * height * width).view(np.uint16)
        return raw.reshape(height, width) * np.float32(DEPTH_SCALE_M)

    def _read(self, at: int, length: int) -> UInt8:
        return np.fromfile(self._path, np.uint8, length, offset=at)


def write_loop(
    path: Path, frames: Iterable[tuple[UInt8, Float32, dict[str, Any]]], facts: dict[str, Any]
) -> None:
    """Write colour, depth and facts of every frame, and facts of the whole, then put the file in place.

    Raises InputError where the folder cannot be written.
    """
    room = "a folder with room for about 200 MB"
    with writing(path.parent, room, "Set XDG_CACHE_HOME to another one."):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole(path) as part, part.open("wb") as out:
            _write(out, frames, facts)


def _write(out: Any, frames: Iterable[tuple[UInt8, Float32, dict[str, Any]]], facts: dict[str, Any]) -> None:
    index: list[tuple[int, int, int]] = []
    rows: list[dict[str, Any]] = []
    size, place, check = (0, 0), 0, 0

    def put(data: bytes) -> int:
        nonlocal place, check
        at = place
        data += b"\0" * (-len(data) % _ALIGN)
        out.write(data)
        place, check = place + len(data), zlib.crc32(data, check)
        return at

    for color, depth, row in frames:
        ok, jpeg = cv2.imencode(
            ".jpg", cv2.cvtColor(color, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 95]
        )
        assert ok
        steps = np.rint(depth / DEPTH_SCALE_M)
        raw = np.where(steps > 65535, 0, steps).astype(np.uint16)
        index.append((put(jpeg.tobytes()), len(jpeg), put(raw.tobytes())))
        size = raw.shape
        rows.append(row)
    tail = json.dumps({"facts": facts, "rows": rows, "index": index, "size": size}).encode()
    check = zlib.crc32(tail, check)
    out.write(tail + len(tail).to_bytes(8, "little") + check.to_bytes(8, "little") + MAGIC)


def kept_loop(
    path: Path, draw: Callable[[], Iterable[tuple[UInt8, Float32, dict[str, Any]]]], facts: dict[str, Any]
) -> tuple[Loop, list[dict[str, Any]]]:
    """The loop in `path` and the facts of its frames; drawn and written first where there is none. Raises
    InputError where the folder cannot be written."""
    found = open_loop(path)
    if found is None:
        write_loop(path, draw(), facts)
        found = open_loop(path)
    if found is None:
        raise InputError(path, found="a file that changed while it was written", fix="Try again.")
    return found


def open_loop(path: Path) -> tuple[Loop, list[dict[str, Any]]] | None:
    """The loop in `path` and the facts of its frames; None when there is none, or not a whole one."""
    try:
        with path.open("rb") as file:
            size = max(os.fstat(file.fileno()).st_size - _END, 0)
            check = 0
            for at in range(0, size, _CHUNK):
                check = zlib.crc32(file.read(min(_CHUNK, size - at)), check)
            end = file.read(_END)
            length = int.from_bytes(end[:8], "little")
            if end[16:] != MAGIC or length > size or int.from_bytes(end[8:16], "little") != check:
                return None
            file.seek(size - length)
            stored = json.loads(file.read(length))
    except OSError:
        return None
    height, width = stored["size"]
    index = [(int(a), int(b), int(c)) for a, b, c in stored["index"]]
    return Loop(stored["facts"], path, index, (height, width)), stored["rows"]
