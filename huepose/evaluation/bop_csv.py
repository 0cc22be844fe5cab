"""Results in the file format of the BOP challenge 2019 and later: one line a pose, millimetres.

https://bop.felk.cvut.cz/challenges/bop-challenge-2019/#formatofresults:
`scene_id,im_id,obj_id,score,R,t,time`, R row by row, t in mm, time in seconds for the whole image.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huepose.datasets import files
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.support.errors import InputError
from huepose.support.files import write_text

_HEADER = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")


@dataclass(frozen=True, eq=False)
class BopResult:
    """One line: T_cam_obj (4, 4) metres; score: higher is surer; seconds for the image, -1: not known."""

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
    """Read a result file. Raises InputError, naming the line; where `broken` is given, lines without a pose
    (not a number, no rotation) are described there instead."""
    text = files.read_bytes(Path(path)).decode("utf-8", "replace")
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
        if not se3.is_rigid(T_cam_obj, 1e-2):
            if broken is not None:
                broken.append(f"line {number}: no rotation or not finite")
                continue
            raise InputError(f"{path}, line {number}", found="a matrix that is no rotation")
        results.append(BopResult(scene, values[0], values[1], values[2], T_cam_obj, values[3]))
    return results
