"""What rivals answered, image by image, in a journal that may be gone on with: slow methods run in pieces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from huepose.evaluation.estimate_rows import EstimateResult, EstimateRow
from huepose.evaluation.tables.journal import Journal
from huepose.evaluation.targets import PoseError

Image = tuple[str, int]
"""Scene folder and number of an image."""


def key_of(method: str, masks: str, image: Image) -> str:
    """Of a piece of work in the journal."""
    return f"{method}, masks {masks}, {image[0]}/{image[1]}"


def piece_of(image: Image, rows: Sequence[EstimateRow], cpu_s: Sequence[float]) -> dict[str, Any]:
    """What is kept: the answers in one image and the CPU seconds of each."""
    return {"scene": image[0], "image": image[1], "cpu_s": list(cpu_s), "rows": [_short(r) for r in rows]}


def summary(
    journal: Journal, method: str, masks: str, images: Sequence[Image], seed: int
) -> dict[str, Any] | None:
    """Figures over those of the images that hold answers, as in `EstimateResult.summary`, with `cpu_s_p50`
    and `cpu_s_mean` of an object; None without any."""
    keys = [key_of(method, masks, image) for image in images]
    pieces = [journal.entries[key] for key in keys if key in journal.entries]
    rows = [_row(row, piece, seed) for piece in pieces for row in piece["rows"]]
    if not rows:
        return None
    seconds = np.array([s for piece in pieces for s in piece["cpu_s"] if s > 0])
    spent = {"cpu_s_p50": float(np.median(seconds)), "cpu_s_mean": float(seconds.mean())}
    return {**EstimateResult(rows, [], 0, "", masks, (seed,)).summary(), **spent}


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
