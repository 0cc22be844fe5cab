"""What rivals answered, image by image, in a journal that may be gone on with: slow methods run in pieces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from huepose.evaluation.estimate_rows import EstimateRow, summary_of
from huepose.evaluation.tables.journal import Journal

Image = tuple[str, int]
"""Scene folder and number of an image."""


def key_of(method: str, masks: str, image: Image) -> str:
    """Of a piece of work in the journal."""
    return f"{method}, masks {masks}, {image[0]}/{image[1]}"


def piece_of(image: Image, rows: Sequence[EstimateRow], cpu_s: Sequence[float]) -> dict[str, Any]:
    """What is kept: the answers in one image and the CPU seconds of each."""
    records = [row.as_json() for row in rows]
    short = [{k: v for k, v in row.items() if k not in ("terms", "alternatives", "box")} for row in records]
    return {"scene": image[0], "image": image[1], "cpu_s": list(cpu_s), "rows": short}


def summary(journal: Journal, method: str, masks: str, images: Sequence[Image]) -> dict[str, Any] | None:
    """Figures over those of the images that hold answers, as in a result file, with `cpu_s_p50` and
    `cpu_s_mean` of an object; None without any."""
    keys = [key_of(method, masks, image) for image in images]
    pieces = [journal.entries[key] for key in keys if key in journal.entries]
    # Scenes of different sets share names, so a row is of its folder.
    rows = [{**row, "scene": piece["scene"]} for piece in pieces for row in piece["rows"]]
    if not rows:
        return None
    seconds = np.array([s for piece in pieces for s in piece["cpu_s"] if s > 0])
    spent = {"cpu_s_p50": float(np.median(seconds)), "cpu_s_mean": float(seconds.mean())}
    return {**summary_of(rows), **spent}
