"""Uncertainty of figures from few frames: intervals by bootstrap (resampling with replacement), and a sign
test.

Dependent rows are drawn together (Efron and Tibshirani 1993, the bootstrap over clusters). For a figure these
are the rows of a frame, because its objects share light and noise; for the change of a figure they are units
that the caller names.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from huepose.geometry.arrays import Bool, Float, Float64, Int64

Interval = tuple[float, float]


SHARE = 0.95
"""Share of the resamples within an interval."""


def frame_intervals(values: Mapping[str, Float], frames: Sequence[Hashable]) -> dict[str, Interval | None]:
    """For each figure the central interval of its mean with `SHARE` of 2000 resamples, widened as in
    `difference_intervals`. None for fewer than two frames.

    values: one number for each instance (N,), by figure; frames: the frame of each instance (N,).

    >>> frame_intervals({"recall": np.array([100.0, 100.0, 100.0])}, [1, 1, 2])
    {'recall': (100.0, 100.0)}
    """
    if len(set(frames)) < 2:
        return dict.fromkeys(values)
    index, times = _draws(frames, 2000, 0)
    return {
        name: _interval(_drawn(Share.of(each), index, times), times.shape[1]) for name, each in values.items()
    }


@dataclass(frozen=True, eq=False)
class Share:
    """One figure of N rows: `part.sum() / whole.sum()`, each (N,). For a mean, `whole` is one in every row
    that counts and zero in the others."""

    part: Float64
    whole: Float64

    @staticmethod
    def of(values: Float, counts: Bool | None = None) -> Share:
        """The mean of values (N,) over the rows that count (N,), by default all."""
        values = np.asarray(values, np.float64)
        counted = np.ones(len(values), bool) if counts is None else np.asarray(counts, bool)
        return Share(np.where(counted, values, 0.0), counted.astype(np.float64))

    @property
    def value(self) -> float | None:
        """The figure; None where no row counts."""
        whole = float(self.whole.sum())
        return float(self.part.sum()) / whole if whole else None

    def only(self, chosen: Int64) -> Share:
        """The figure of the rows with these indices."""
        return Share(self.part[chosen], self.whole[chosen])


def difference_intervals(
    pairs: Mapping[str, tuple[Share, Share]], units: Sequence[Hashable], resamples: int = 4000, seed: int = 0
) -> dict[str, Interval | None]:
    """For each figure the interval of its change, second minus first, over the same N rows.

    units: the unit of each row (N,); rows of one unit are drawn together. The percentiles are widened as
    for a t interval with one degree of freedom less than there are units, because plain percentiles are too
    narrow when units are few (Hesterberg 2015, What teachers should know about the bootstrap, 'expanded
    percentiles'). None for fewer than two units, or if no row counts.

    >>> rows = np.array([100.0, 0.0])
    >>> difference_intervals({"recall": (Share.of(rows), Share.of(rows))}, ["a", "b"])
    {'recall': (0.0, 0.0)}
    """
    if len(set(units)) < 2:
        return dict.fromkeys(pairs)
    index, times = _draws(units, resamples, seed)
    result: dict[str, Interval | None] = {}
    for name, (before, after) in pairs.items():
        changes = _drawn(after, index, times) - _drawn(before, index, times)
        known = changes[np.isfinite(changes)]
        result[name] = _interval(known, times.shape[1]) if len(known) else None
    return result


def sign_test(wins: int, losses: int) -> float:
    """Probability that wins and losses are at least as uneven as these by chance: exact, two-sided (McNemar).

    >>> sign_test(0, 6), sign_test(3, 3), sign_test(0, 0)
    (0.03125, 1.0, 1.0)
    """
    return min(1.0, 2.0 * float(special.bdtr(min(wins, losses), wins + losses, 0.5)))


def _interval(drawn: Float64, units: int) -> Interval:
    """The expanded percentiles of a figure in the resamples (R,)."""
    tail = 50.0 * (1.0 - _expanded(SHARE, units))
    low, high = np.percentile(drawn, [tail, 100.0 - tail])
    return float(low), float(high)


def _expanded(share: float, units: int) -> float:
    """Share of the resamples between the widened percentiles, as of a t interval over this number of
    units."""
    t = float(special.stdtrit(units - 1, 0.5 + 0.5 * share))
    return 2.0 * float(special.ndtr(t * np.sqrt(units / (units - 1)))) - 1.0


def _draws(units: Sequence[Hashable], resamples: int, seed: int) -> tuple[Int64, Int64]:
    """Index of the unit of each row (N,), and how often each unit is drawn in each resample (R, U)."""
    number = {unit: k for k, unit in enumerate(dict.fromkeys(units))}
    index = np.array([number[unit] for unit in units], np.int64)
    even = np.full(len(number), 1.0 / len(number))
    return index, np.random.default_rng(seed).multinomial(len(number), even, resamples)


def _drawn(share: Share, index: Int64, times: Int64) -> Float64:
    """A figure in each resample (R,); nan where no row that counts was drawn."""
    part, whole = (times @ np.bincount(index, weights=each) for each in (share.part, share.whole))
    return np.asarray(np.divide(part, whole, out=np.full(len(part), np.nan), where=whole > 0))
