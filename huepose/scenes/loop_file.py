"""The file that a computed loop is kept in: a zip of pictures, and of what is known of them.

Colour is JPEG (as most cameras deliver it), depth raw uint16, nothing is packed further, so that playing it
costs little. A file is written beside its name and moved there when complete; on opening, everything is
checked, and whoever asked computes the loop anew when it does not hold.

Whoever writes or plays a loop holds a lock on its file. Loops that nobody has asked for in `UNUSED_DAYS` go
when the next one is written, and so do the parts that a killed writer left.
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
"""Less than for what is derived from a user's files: a loop is 165 to 500 MB, and drawn anew in 20 s."""
_FACTS = "facts.json"


@dataclass(frozen=True, eq=False)
class Loop:
    """The pictures of an opened loop. They are read, not mapped: a loop that is played would lie whole in the
    process's memory."""

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
    """Write colour, depth and facts of every frame, then put the file in place.

    Raises InputError where the folder cannot be written.
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
    """Say that the file is in use, as long as it is open."""
    assert file.fp is not None
    with suppress(OSError):  # some network drives know no locks
        fcntl.flock(file.fp, fcntl.LOCK_SH | fcntl.LOCK_NB)


def _tidy(folder: Path) -> None:
    """Remove the loops that nobody asks for and the parts that nobody writes any more."""
    for path in (*unused(folder.glob("*.loop"), UNUSED_DAYS), *folder.glob(".*.loop.*.part")):
        with suppress(OSError), path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # refused where it is in use
            path.unlink()


def kept_loop(
    path: Path, draw: Callable[[], Iterable[tuple[UInt8, Float32, dict[str, Any]]]]
) -> tuple[Loop, list[dict[str, Any]]]:
    """The loop in `path` and the facts of its frames; drawn and written first where there is none. Raises
    InputError where the folder cannot be written."""
    found = open_loop(path)
    if found is None:
        write_loop(path, draw())
        found = open_loop(path)
    if found is None:
        raise InputError(path, found="a file that changed while it was written", fix="Try again.")
    return found


def open_loop(path: Path) -> tuple[Loop, list[dict[str, Any]]] | None:
    """The loop in `path` and the facts of its frames; None when there is none, or not a whole one."""
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
    except Exception:  # of what is damaged, zipfile trips over anything
        return None
