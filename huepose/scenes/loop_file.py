"""The file of a rendered loop: a zip of images and of their ground truth.

Colour is JPEG (as most cameras deliver it), depth raw uint16. Nothing is compressed further, so playing costs
little. A file is written under another name and renamed when it is complete. On opening, everything is
checked; a damaged loop is rendered again.

A process that writes or plays a loop holds a lock on its file. When a loop is written, loops that were not
used for `UNUSED_DAYS` are removed, and so are incomplete files of killed writers.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import ZipFile, ZipInfo

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, UInt8
from huepose.geometry.camera import whole_steps
from huepose.support.errors import InputError
from huepose.support.files import whole, writing
from huepose.support.kept import unused

DEPTH_SCALE_M = 1e-4
UNUSED_DAYS = 7
"""Less than for what is derived from a user's files: a loop is 165 to 500 MB, and rendered again in 20 s."""
_FACTS = "facts.json"


@dataclass(frozen=True, eq=False)
class Loop:
    """The images of an opened loop. They are read, not memory-mapped: else the whole loop would end up in the
    memory of the process that plays it."""

    _file: ZipFile
    _count: int
    _size: tuple[int, int]

    def __len__(self) -> int:
        return self._count

    def color(self, i: int) -> UInt8:
        """Colour (H, W, 3) uint8 RGB."""
        image = cv2.imdecode(np.frombuffer(self._file.read(f"{i}.jpg"), np.uint8), cv2.IMREAD_COLOR_RGB)
        assert image is not None
        return np.asarray(image, np.uint8)

    def depth(self, i: int) -> Float32:
        """Depth (H, W) float32 metres, 0 = none."""
        raw = np.frombuffer(self._file.read(f"{i}.depth"), np.uint16)
        return raw.reshape(self._size) * np.float32(DEPTH_SCALE_M)


def write_loop(path: Path, frames: Iterable[tuple[UInt8, Float32, dict[str, Any]]]) -> None:
    """Write colour, depth and ground truth of every frame, then move the file to `path`.

    Raises InputError if the folder cannot be written.
    """
    rows: list[dict[str, Any]] = []
    size = (0, 0)
    with writing(path.parent, "a folder with room for about 200 MB", "Set XDG_CACHE_HOME to another one."):
        path.parent.mkdir(parents=True, exist_ok=True)
        _tidy(path.parent)
        with whole(path) as part, ZipFile(part, "w") as out:
            _hold(out)
            for color, depth, row in frames:
                bgr = cv2.cvtColor(color, cv2.COLOR_RGB2BGR)
                ok, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])
                assert ok
                raw = whole_steps(depth / DEPTH_SCALE_M)
                out.writestr(ZipInfo(f"{len(rows)}.jpg"), jpeg.tobytes())
                out.writestr(ZipInfo(f"{len(rows)}.depth"), raw.tobytes())
                size = raw.shape
                rows.append(row)
            out.writestr(ZipInfo(_FACTS), json.dumps({"rows": rows, "size": size}))


def _hold(file: ZipFile) -> None:
    """Lock the file as in use, as long as it is open."""
    assert file.fp is not None
    with suppress(OSError):  # some network drives do not support locks
        fcntl.flock(file.fp, fcntl.LOCK_SH | fcntl.LOCK_NB)


def _tidy(folder: Path) -> None:
    """Remove unused loops, and incomplete files that no process writes any more."""
    for path in (*unused(folder.glob("*.loop"), UNUSED_DAYS), *folder.glob(".*.loop.*.part")):
        with suppress(OSError), path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # raises OSError if it is in use
            path.unlink()


def kept_loop(
    path: Path, frames: Callable[[], Iterable[tuple[UInt8, Float32, dict[str, Any]]]]
) -> tuple[Loop, list[dict[str, Any]]]:
    """The loop in `path` and the ground truth of its frames. If there is none, it is made from `frames` and
    written first. Raises InputError if the folder cannot be written."""
    found = open_loop(path)
    if found is None:
        write_loop(path, frames())
        found = open_loop(path)
    if found is None:
        raise InputError(path, found="a file that changed while it was written", fix="Try again.")
    return found


def open_loop(path: Path) -> tuple[Loop, list[dict[str, Any]]] | None:
    """The loop in `path` and the ground truth of its frames; None if there is none, or it is damaged."""
    try:
        file = ZipFile(path)
        _hold(file)
        with suppress(OSError):
            os.utime(path)
        if file.testzip() is not None:
            return None
        stored = json.loads(file.read(_FACTS))
        names = [f"{i}.{kind}" for i in range(len(stored["rows"])) for kind in ("jpg", "depth")]
        if file.namelist() != [*names, _FACTS]:
            return None
        height, width = stored["size"]
        return Loop(file, len(stored["rows"]), (height, width)), stored["rows"]
    except Exception:  # zipfile raises errors of any type for damaged files
        return None
