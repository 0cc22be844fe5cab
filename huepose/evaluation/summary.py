"""From errors to the figures of a summary: per object, per sequence, per seed, as percent."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)
Figures = dict[str, float | None]


def grouped(rows: Iterable[T], key: Callable[[T], K]) -> dict[K, list[T]]:
    """Rows by key, in the order in which the keys first appear."""
    groups: dict[K, list[T]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def mean_figures(groups: Iterable[Mapping[str, float | None]]) -> Figures:
    """Mean of each figure over groups; a figure that some groups lack is averaged over the others.

    >>> mean_figures([{"a": 1.0, "b": None}, {"a": 3.0, "b": 5.0}])
    {'a': 2.0, 'b': 5.0}
    """
    groups = list(groups)
    keys = list(dict.fromkeys(key for group in groups for key in group))
    return {key: mean_of([group.get(key) for group in groups]) for key in keys}


def mean_of(values: Iterable[float | None]) -> float | None:
    """Mean of those that are numbers; None when there is none."""
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None


def largest(values: Iterable[float | None]) -> float | None:
    """Largest of those that are numbers; None when there is none."""
    known = [v for v in values if v is not None]
    return max(known) if known else None


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Text table: the first column to the left, the others to the right; numbers with one decimal place.

    >>> print(table(["object", "ADD"], [["mustard", 97.25], ["can", None]]))
    object    ADD
    mustard  97.2
    can         -
    """
    cells = [list(header), *([_cell(value) for value in row] for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    )


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}" if isinstance(value, float) else str(value)
