"""Memory of the workers over time, as their health says it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from huepose.drawing.plots import line_plot
from huepose.evaluation.pictures import write_picture
from huepose_protos.messages import HealthMessage

Said = Sequence[tuple[float, HealthMessage]]
_SETTLED_S = 60.0


def growth(said: Said, start_s: float, until_s: float) -> dict[str, float]:
    """MiB an hour by worker: the slope over the processes that lived longest; a start is none of it."""
    out = {}
    for worker in sorted({m.worker for _, m in said}):
        lives = _lives([(at, m) for at, m in said if m.worker == worker and start_s <= at <= until_s])
        life = max(lives, key=lambda one: one[-1][0] - one[0][0])
        settled = [
            (at, m) for at, m in life if at - life[0][0] >= min(_SETTLED_S, (life[-1][0] - life[0][0]) / 2)
        ]
        if len(settled) > 2:
            hours = np.array([at for at, _ in settled]) / 3600.0
            out[worker] = float(np.polyfit(hours - hours[0], [m.memory_mib for _, m in settled], 1)[0])
    return out


def _lives(said: Said) -> list[Said]:
    return [list(group) for _, group in groupby(said, key=lambda one: one[1].pid)]


def draw(said: Said, start_s: float, path: Path) -> None:
    """A picture of each worker's memory over the minutes."""
    series = {}
    for worker in dict.fromkeys(m.worker for _, m in said):
        own = [(at, m) for at, m in said if m.worker == worker and at >= start_s]
        minutes = np.array([(at - start_s) / 60.0 for at, _ in own])
        series[worker] = (minutes, np.array([m.memory_mib for _, m in own]))
    write_picture(path, line_plot(series, "resident memory", "minutes", "MiB"))
