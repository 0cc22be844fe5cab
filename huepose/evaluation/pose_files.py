"""Files of poses from elsewhere: our CSV, that of the BOP challenge, and those of DOPE as ROFT has them.

CSV: `frame,object,x,y,z,qx,qy,qz,qw`, metres, the reference model's frame; object is a name or a BOP id. An
instance number may follow; further columns are not read.
BOP challenge 2019 and later (https://bop.felk.cvut.cz/challenges/bop-challenge-2019/#formatofresults):
`scene_id,im_id,obj_id,score,R,t,time`, one line for each pose, R row by row, t in mm, time in seconds for the
whole image.
DOPE: row i is frame i, `x y z ax ay az angle`, zeros if nothing was found; in the model frame of NVIDIA
(`poses.txt`) or PoseCNN (`poses_ycb.txt`): p_nvdu = R p_posecnn + t, and p_bop = p_posecnn + offset.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from huepose.datasets import files
from huepose.datasets.fast_ycb import axis_angle_poses
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.support.errors import InputError
from huepose.support.files import write_text

COLUMNS = ("frame", "object", "x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, eq=False)
class PoseTable:
    """T_cam_obj (4, 4) by (frame, name or id of the object in the file); missing poses are not in it."""

    poses: Mapping[tuple[int, str], Float64]

    def pose(self, frame: int, name: str, object_id: int | None) -> Float64 | None:
        """The pose of an object, by name or by id."""
        found = self.poses.get((frame, name))
        return found if found is not None or object_id is None else self.poses.get((frame, str(object_id)))

    def moved(self, T_theirs_obj: Mapping[str, Float64]) -> PoseTable:
        """The poses in the reference models' frames. T_theirs_obj: by name or id of the object in the file,
        takes points of the reference model to the file's model frame. Poses of other objects are left out."""
        return PoseTable(
            {
                (frame, name): se3.compose(T, T_theirs_obj[name])
                for (frame, name), T in self.poses.items()
                if name in T_theirs_obj
            }
        )


class PoseRow(NamedTuple):
    """A row of our CSV. instance: None if the file does not have it; T (4, 4): usually T_cam_obj."""

    frame: int
    object: str
    instance: int | None
    T: Float64

    @property
    def name(self) -> str:
        """OBJECT, or OBJECT/INSTANCE."""
        return self.object if self.instance is None else f"{self.object}/{self.instance}"


def read_pose_csv(path: Path | str) -> PoseTable:
    """Read our CSV as a table; of several instances of an object in a frame, the last one is used. Raises
    InputError."""
    return PoseTable({(row.frame, row.object): row.T for row in read_pose_rows(path)})


def read_pose_rows(path: Path | str) -> list[PoseRow]:
    """Read our CSV, with or without its header; rows with nan are missing poses. Raises InputError."""
    # Spreadsheet programs write a byte order mark, and other line ends.
    text = files.read_bytes(Path(path)).decode("utf-8-sig", "replace")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").replace("\0", "?").splitlines()
    rows: list[PoseRow] = []
    # A row is a line: no value contains a line end, so an open quote affects only its own line.
    for line, row in enumerate((text.split(",") for text in lines), 1):
        cells = [cell.strip().strip('"') for cell in row]
        if not any(cells) or (line == 1 and cells[0] == COLUMNS[0]):
            continue
        try:
            frame, values = _whole(cells[0]), np.array([float(cell) for cell in cells[2:9]])
            instance = _whole(cells[9]) if len(cells) > 9 else None
        except (ValueError, IndexError):
            frame, values, instance = 0, np.empty(0), None
        if len(values) != 7:
            raise InputError(f"{path}, line {line}", found=",".join(row)[:60], expected=",".join(COLUMNS))
        if not np.isfinite(values).all():
            continue
        if abs(np.linalg.norm(values[3:]) - 1.0) > 0.05:
            raise InputError(
                f"{path}, line {line}",
                found=f"{','.join(row)[:80]}, whose quaternion {values[3:]} is not of length 1",
                expected=",".join(COLUMNS),
                fix="Write numbers with a decimal point.",
            )
        T = se3.make(se3.rotation_from_quaternion(values[3:]), values[:3])
        rows.append(PoseRow(frame, cells[1], instance, T))
    if not rows:
        raise InputError(path, found="no pose", expected=",".join(COLUMNS))
    return rows


def _whole(cell: str) -> int:
    """An integer, also in the form `100.0`, which pandas writes if a value of the column is missing. Raises
    ValueError."""
    try:
        return int(cell)
    except ValueError:
        if not (number := float(cell)).is_integer():
            raise
        return int(number)


def read_dope_poses(path: Path | str, name: str) -> PoseTable:
    """Read DOPE's poses of one object, in the file's model frame. Raises InputError."""
    return PoseTable(
        {
            (frame, name): T_cam_nvdu
            for frame, T_cam_nvdu in enumerate(axis_angle_poses(Path(path)))
            if np.isfinite(T_cam_nvdu).all()
        }
    )


_HEADER = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")


@dataclass(frozen=True, eq=False)
class BopResult:
    """One line: T_cam_obj (4, 4) metres; score: higher is better; seconds: for the image, -1 if unknown."""

    scene: str
    image: int
    object_id: int
    score: float
    T_cam_obj: Float64
    seconds: float = -1.0


def write_bop_csv(path: Path | str, results: Iterable[BopResult]) -> None:
    """Write a result file. Scenes named by a number are written as that number. Raises InputError."""
    lines = [",".join(_HEADER)]
    for result in results:
        scene = str(int(result.scene)) if result.scene.isdigit() else result.scene
        R = " ".join(repr(float(v)) for v in result.T_cam_obj[:3, :3].ravel())
        t = " ".join(repr(float(v) * 1000.0) for v in result.T_cam_obj[:3, 3])
        seconds = repr(float(result.seconds))
        lines.append(f"{scene},{result.image},{result.object_id},{float(result.score)!r},{R},{t},{seconds}")
    write_text(path, "\n".join(lines) + "\n")


def read_bop_csv(path: Path | str, broken: list[str] | None = None) -> list[BopResult]:
    """Read a result file. Raises InputError, naming the line; if `broken` is given, lines without a valid
    pose (not finite, not a rotation) are described there instead."""
    text = files.read_bytes(Path(path)).decode("utf-8-sig", "replace")  # may begin with a byte order mark
    rows = list(csv.reader(io.StringIO(text)))
    results = []
    for number, row in enumerate(rows, 1):
        if not row or (number == 1 and row[0] == _HEADER[0]):
            continue
        try:
            scene, image, object_id, score, R_text, t_text, seconds = row
            R = np.array([float(v) for v in R_text.split()]).reshape(3, 3)
            t_m = np.array([float(v) for v in t_text.split()]).reshape(3) / 1000.0
            values = int(image), int(object_id), float(score), float(seconds)
        except ValueError:
            raise InputError(
                f"{path}, line {number}", found=",".join(row)[:60], expected=",".join(_HEADER)
            ) from None
        T_cam_obj = se3.make(R, t_m)
        if not se3.is_rigid(T_cam_obj, se3.ROUNDED):
            if broken is not None:
                broken.append(f"line {number}: not a rotation, or not finite")
                continue
            raise InputError(f"{path}, line {number}", found="a matrix that is no rotation")
        results.append(BopResult(scene, values[0], values[1], values[2], T_cam_obj, values[3]))
    return results
