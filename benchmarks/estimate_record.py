"""What rivals answered, image by image, in a file that may be gone on with: slow methods run in pieces."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from huepose.evaluation.estimate_rows import EstimateResult, EstimateRow
from huepose.evaluation.result_files import plain, write_json
from huepose.evaluation.targets import PoseError
from huepose.support.errors import InputError

Image = tuple[str, int]
"""Scene folder and number of an image."""


class Record:
    """A file of answers. Pieces are kept by method, masks and image; what it holds is not asked again."""

    def __init__(self, path: Path, options: Mapping[str, Any]) -> None:
        """options: what all pieces have in common. Raises InputError where the file was made with others."""
        self._path, self._options = path, plain(dict(options))
        self._pieces: dict[tuple[str, str, Image], dict[str, Any]] = {}
        if not path.exists():
            return
        try:
            held = json.loads(path.read_text())
            pieces = {(p["method"], p["masks"], (p["scene"], p["image"])): p for p in held["pieces"]}
        except (ValueError, KeyError, TypeError):
            raise InputError(path, found="not a file of this benchmark", fix="Name another one.") from None
        if held["options"] != self._options:
            raise InputError(
                path,
                found=f"answers with the options {held['options']}",
                expected=f"{self._options}",
                fix="Name another file.",
            )
        self._pieces = pieces

    def has(self, method: str, masks: str, image: Image) -> bool:
        """Whether this was answered."""
        return (method, masks, image) in self._pieces

    def add(
        self, method: str, masks: str, image: Image, rows: Sequence[EstimateRow], cpu_s: Sequence[float]
    ) -> None:
        """Keep the answers in one image and the CPU seconds of each, and write the file."""
        piece = {
            "method": method,
            "masks": masks,
            "scene": image[0],
            "image": image[1],
            "cpu_s": list(cpu_s),
            "rows": [_short(row) for row in rows],
        }
        self._pieces[method, masks, image] = plain(piece)
        write_json(self._path, {"options": self._options, "pieces": list(self._pieces.values())})

    def summary(self, method: str, masks: str, images: Sequence[Image], seed: int) -> dict[str, Any] | None:
        """Figures over those of the images that hold answers, as in `EstimateResult.summary`, with
        `cpu_s_p50` and `cpu_s_mean` of an object; None without any."""
        pieces = [self._pieces[method, masks, i] for i in images if (method, masks, i) in self._pieces]
        rows = [_row(row, piece, seed) for piece in pieces for row in piece["rows"]]
        if not rows:
            return None
        result = EstimateResult(rows, [], 0, str(self._options.get("boxes")), masks, (seed,))
        seconds = np.array([s for piece in pieces for s in piece["cpu_s"] if s > 0])
        spent = {"cpu_s_p50": float(np.median(seconds)), "cpu_s_mean": float(seconds.mean())}
        return {**result.summary(), **(spent if len(seconds) else dict.fromkeys(spent, float("nan")))}


_KEPT = ("instance", "object", "visib_fract", "T_cam_obj", "diameter_m", "quality", "state", "seconds")


def _short(row: EstimateRow) -> dict[str, Any]:
    """What is kept of a row."""
    whole = row.as_json()
    return {name: whole[name] for name in (*_KEPT, "add_m", "adds_m", "add_official_m", "right")}


def _row(kept: Mapping[str, Any], piece: Mapping[str, Any], seed: int) -> EstimateRow:
    """The row as it was."""
    add, adds, official = (
        np.inf if kept[name] is None else kept[name] for name in ("add_m", "adds_m", "add_official_m")
    )
    T = None if kept["T_cam_obj"] is None else np.array(kept["T_cam_obj"])
    own = {name: kept[name] for name in _KEPT if name != "T_cam_obj"}
    error = PoseError(add, adds, official, kept["right"])
    return EstimateRow(piece["scene"], piece["image"], **own, T_cam_obj=T, error=error, seed=seed, box=None)
