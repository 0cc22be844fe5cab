"""Figures of a summary from errors: per object, per sequence, per seed, in percent; with intervals.

Rows are in their file form. A label or frame without a pose is wrong in every figure.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from huepose.evaluation import metrics
from huepose.evaluation.bootstrap import Interval, frame_intervals
from huepose.geometry.arrays import Float64

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
    """Mean of each figure over the groups that have it.

    >>> mean_figures([{"a": 1.0, "b": None}, {"a": 3.0, "b": 5.0}])
    {'a': 2.0, 'b': 5.0}
    """
    groups = list(groups)
    keys = list(dict.fromkeys(key for group in groups for key in group))
    return {key: mean_of([group.get(key) for group in groups]) for key in keys}


def mean_of(values: Iterable[float | None]) -> float | None:
    """Mean of the values that are not None; None if there are none."""
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None


def largest(values: Iterable[float | None]) -> float | None:
    """Largest of the values that are not None; None if there are none."""
    known = [v for v in values if v is not None]
    return max(known) if known else None


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Text table: the first column left-aligned, the others right-aligned; numbers with one decimal place.

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


def span(interval: Sequence[float] | None, digits: int = 1) -> str:
    """An interval as text; `-` if there is none.

    >>> span((93.2, 99.61)), span(None)
    ('93.2 to 99.6', '-')
    """
    return "-" if interval is None else f"{interval[0]:.{digits}f} to {interval[1]:.{digits}f}"


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}" if isinstance(value, float) else str(value)


Row = Mapping[str, Any]
POSE_FIGURES = (*metrics.FIGURES, "auc_voc_add", "auc_voc_adds")


def errors(rows: Sequence[Row], key: str) -> Float64:
    """Errors (N,) in metres; inf without a pose."""
    return np.array([np.inf if row[key] is None else row[key] for row in rows], np.float64)


def pose_scores(rows: Sequence[Row], add_key: str = "add_m") -> dict[str, Float64]:
    """For recall and AUC one number for each of N rows, percent; the figure is their mean."""
    diameters = np.array([float(row["diameter_m"]) for row in rows])
    return metrics.pose_scores(errors(rows, add_key), errors(rows, "adds_m"), diameters)


def pose_figures(rows: Sequence[Row], add_key: str = "add_m") -> Figures:
    """POSE_FIGURES of N rows: recall, and AUC in both forms, percent; None if N is 0."""
    if not rows:
        return dict.fromkeys(POSE_FIGURES)
    return {
        **{name: float(each.mean()) for name, each in pose_scores(rows, add_key).items()},
        "auc_voc_add": metrics.auc_voc(errors(rows, add_key)),
        "auc_voc_adds": metrics.auc_voc(errors(rows, "adds_m")),
    }


def pose_intervals(
    rows: Sequence[Row], units: Sequence[Hashable], add_key: str = "add_m"
) -> dict[str, Interval | None]:
    """95 % intervals of recall and AUC. units: the unit of each row; rows of one unit are drawn together."""
    return frame_intervals(pose_scores(rows, add_key), units)
