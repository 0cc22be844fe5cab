"""Memory of the workers over time, from their health."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from huepose.geometry.arrays import Float64
from huepose_protos.messages import HealthMessage

Said = Sequence[tuple[float, HealthMessage]]
_SETTLED_S = 60.0
_LEAST_S = 300.0
"""The rate for an hour is not computed from less than this."""
_JUMPS = 20
"""A step is tried at this many of the largest changes."""


@dataclass(frozen=True)
class Growth:
    """Memory of a worker during its longest process; mib_per_hour: None if that was too short."""

    minutes: float
    first_mib: float
    last_mib: float
    mib_per_hour: float | None

    def __str__(self) -> str:
        """The growth in words."""
        rate = "" if self.mib_per_hour is None else f", {self.mib_per_hour:+.1f} MiB an hour"
        return f"{self.first_mib:.0f} to {self.last_mib:.0f} MiB in {self.minutes:.1f} minutes{rate}"


def growth(said: Said, start_s: float, until_s: float) -> dict[str, Growth]:
    """The growth of each worker, for the process that lived longest, without the time of its start.

    The rate is the slope of a line with one step: memory that is taken once, at the first large request, is
    no growth.
    """
    out = {}
    for worker in sorted({m.worker for _, m in said}):
        own = [(at, m) for at, m in said if m.worker == worker and start_s <= at <= until_s]
        lives = [list(group) for _, group in groupby(own, key=lambda one: one[1].pid)]
        life = max(lives, key=lambda one: one[-1][0] - one[0][0], default=[])
        settled = [
            (at, m) for at, m in life if at - life[0][0] >= min(_SETTLED_S, (life[-1][0] - life[0][0]) / 2)
        ]
        if len(settled) > 2:
            seconds = np.array([at for at, _ in settled]) - settled[0][0]
            mib = np.array([m.memory_mib for _, m in settled])
            known = 3600.0 * _slope(seconds, mib) if seconds[-1] >= _LEAST_S else None
            out[worker] = Growth(float(seconds[-1]) / 60.0, float(mib[0]), float(mib[-1]), known)
    return out


def _slope(t: Float64, y: Float64) -> float:
    """The slope of the line with one step that fits best."""
    fits = []
    for place in np.argsort(-np.abs(np.diff(y)))[:_JUMPS]:
        columns = np.column_stack([t, np.ones_like(t), t > t[place]])
        solution = np.linalg.lstsq(columns, y, rcond=None)[0]
        fits.append((float(((columns @ solution - y) ** 2).sum()), float(solution[0])))
    return min(fits)[1]
