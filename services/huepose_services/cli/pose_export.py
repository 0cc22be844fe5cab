"""`huepose poses --csv` and `--tum`: write TRACKING poses to files that other programs read."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TextIO

from huepose.support.errors import InputError
from huepose.support.files import writing
from huepose_protos.messages import Message, PoseMessage

CSV_COLUMNS = "frame,object,x,y,z,qx,qy,qz,qw,instance,stamp,quality"
"""stamp: capture time on the realtime clock, seconds."""

TUM_COLUMNS = "# timestamp tx ty tz qx qy qz qw"


class PoseFiles:
    """Writes every TRACKING pose: a row of `csv`, and a line of DIR/OBJECT_INSTANCE.txt (`tum`).

    Times are capture times on the realtime clock, seconds; poses are T_cam_obj, metres. A rotation has two
    quaternions: the one nearer to the previous row's is written, so that rows can be interpolated. Each
    line is in its file at once. Without any pose, `csv` is removed.

    Raises InputError for a file or folder that is not empty, and for disk errors."""

    def __init__(self, csv: Path | None, tum: Path | None) -> None:
        self._tum = tum
        self._files: dict[Path, TextIO] = {}
        self._turned: dict[tuple[str, int], tuple[float, ...]] = {}
        self.written = 0
        self._csv = csv
        if csv is not None and csv.is_file() and csv.stat().st_size:
            raise InputError(csv, found="a file of that name", expected="a new one")
        if tum is not None and tum.is_dir() and any(tum.iterdir()):
            raise InputError(tum, found="something there", expected="a new or empty folder")
        if csv is not None:
            self._write(csv, CSV_COLUMNS)
        if tum is not None:
            with writing(tum):
                tum.mkdir(parents=True, exist_ok=True)

    def _write(self, path: Path, *lines: str) -> None:
        """Append lines to a file; if that fails, an empty file is removed."""
        with writing(path):
            file = self._files.get(path) or path.open("w", buffering=1)
            self._files[path] = file
            try:
                for line in lines:
                    file.write(line + "\n")
            except OSError:
                with suppress(OSError):
                    file.close()
                if path.is_file() and path.stat().st_size == 0:
                    path.unlink()
                raise

    def take(self, message: Message) -> None:
        """Write the message if it is a TRACKING pose."""
        if not isinstance(message, PoseMessage) or message.state != "TRACKING":
            return
        if message.translation is None or message.quaternion is None:
            return
        quaternion = self._continued((message.object, message.instance), message.quaternion)
        values = [f"{value:.9f}" for value in (*message.translation, *quaternion)]
        self.written += 1
        seconds, rest = divmod(message.capture_ns + message.realtime_offset_ns, 1_000_000_000)
        stamp = f"{seconds}.{rest:09d}"
        if self._csv is not None:
            who = f"{message.frame_id},{message.object}"
            more = f"{message.instance},{stamp},{message.quality:.4f}"
            self._write(self._csv, f"{who},{','.join(values)},{more}")
        if self._tum is not None:
            path = self._tum / f"{message.object}_{message.instance}.txt"
            heading = () if path in self._files else (TUM_COLUMNS,)
            self._write(path, *heading, f"{stamp} {' '.join(values)}")

    def _continued(self, whose: tuple[str, int], quaternion: tuple[float, ...]) -> tuple[float, ...]:
        """The same rotation, with the sign that is nearer to the previous row's quaternion."""
        before = self._turned.get(whose, quaternion)
        if sum(a * b for a, b in zip(before, quaternion, strict=True)) < 0.0:
            quaternion = tuple(-value for value in quaternion)
        self._turned[whose] = quaternion
        return quaternion

    def __enter__(self) -> PoseFiles:
        return self

    def __exit__(self, *error: object) -> None:
        for file in self._files.values():
            file.close()
        csv = self._csv
        if csv is not None and not self.written and csv.is_file() and not csv.is_symlink():  # not /dev/stdout
            csv.unlink()
