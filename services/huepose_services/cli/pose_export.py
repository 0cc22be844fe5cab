"""`huepose poses --csv` and `--tum`: poses that may be acted on, into files that other programs read."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TextIO

from huepose.support.errors import InputError
from huepose.support.files import writing
from huepose_protos.messages import Message, PoseMessage

CSV_COLUMNS = "frame,object,x,y,z,qx,qy,qz,qw,instance,stamp,quality"
"""stamp: of the capture, on the realtime clock, seconds."""

TUM_COLUMNS = "# timestamp tx ty tz qx qy qz qw"


class PoseFiles:
    """Writes every TRACKING pose: a row of `csv`, and a line of DIR/OBJECT_INSTANCE.txt (`tum`).

    Stamps are of the capture, on the realtime clock, seconds; poses are T_cam_obj, metres. Of the two
    quaternions of a rotation the one nearer to that of the row before is written, so that they can be
    interpolated. A line is in its file at once; without a pose there is no `csv`.

    Raises InputError for a file or a folder that has something in it, and for what the disk does not take."""

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
        """Lines at the end of a file; no empty one stays."""
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
        """Write it, where it is a pose that may be acted on."""
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
        """The same rotation, with the sign that continues the row before."""
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
