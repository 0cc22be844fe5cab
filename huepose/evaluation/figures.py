"""Pose figures of measured rows, in the form that they have in files, and their intervals.

A label or frame without a pose is wrong in every figure.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import numpy as np

from huepose.evaluation import metrics
from huepose.evaluation.bootstrap import Interval, frame_intervals
from huepose.evaluation.summary import Figures
from huepose.geometry.arrays import Float64

Row = Mapping[str, Any]
POSE_FIGURES = (*metrics.FIGURES, "auc_voc_add", "auc_voc_adds")


def errors(rows: Sequence[Row], key: str) -> Float64:
    """Errors (N,) in metres; inf where there is no pose."""
    return np.array([np.inf if row[key] is None else row[key] for row in rows], np.float64)


def pose_scores(rows: Sequence[Row], add_key: str = "add_m") -> dict[str, Float64]:
    """What recall and AUC are the means of: a number for each of N rows, percent."""
    diameters = np.array([float(row["diameter_m"]) for row in rows])
    return metrics.pose_scores(errors(rows, add_key), errors(rows, "adds_m"), diameters)


def pose_figures(rows: Sequence[Row], add_key: str = "add_m") -> Figures:
    """POSE_FIGURES of N rows: recall, and AUC both ways, percent; None when N is 0."""
    if not rows:
        return dict.fromkeys(POSE_FIGURES)
    return {
        **{name: float(each.mean()) for name, each in pose_scores(rows, add_key).items()},
        "auc_voc_add": metrics.auc_voc(errors(rows, add_key)),
        "auc_voc_adds": metrics.auc_voc(errors(rows, "adds_m")),
    }


def pose_intervals(
    rows: Sequence[Row], unit: Callable[[Row], Hashable], add_key: str = "add_m"
) -> dict[str, Interval]:
    """Where recall and AUC lie in 95 % of draws of units: rows of one unit are drawn together."""
    return frame_intervals(pose_scores(rows, add_key), [unit(row) for row in rows])
