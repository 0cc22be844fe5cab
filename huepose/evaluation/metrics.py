"""Pose errors and the figures made of them. Pure functions on arrays; errors in metres, figures in percent.

A missing pose has the error inf: it is wrong in recall and 0 in AUC.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from huepose.drawing.plots import reliability_bins
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float64

AUC_LIMIT_M = 0.1
RECALL_FRACTION = 0.1
FIGURES = ("recall_add", "recall_adds", "auc_add", "auc_adds")
_CALIBRATION_BINS = 10


def add(points_obj: Float, T_estimate: Float, T_truth: Float) -> float:
    """ADD: mean distance of the model points (N, 3) in two poses, metres (Hinterstoisser et al. 2012).

    >>> points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    >>> round(add(points, se3.make(np.eye(3), [0, 0, 0.02]), np.eye(4)), 6)
    0.02
    """
    moved = se3.apply(T_estimate, points_obj) - se3.apply(T_truth, points_obj)
    return float(np.linalg.norm(moved, axis=1).mean())


def adds(points_obj: Float, T_estimate: Float, T_truth: Float, tree: cKDTree | None = None) -> float:
    """ADD-S: mean over the *truth's* points of the distance to the estimate's nearest point, metres.

    tree: a cKDTree of `points_obj`. Distances do not change when both clouds move together, so the truth
    is taken into the estimate's object frame and one tree serves every pose of a model."""
    T_estimate_truth = se3.inverse(T_estimate) @ T_truth
    tree = cKDTree(points_obj) if tree is None else tree
    distances, _ = tree.query(se3.apply(T_estimate_truth, points_obj))
    return float(distances.mean())


def recall(errors_m: Float, diameters_m: Float) -> float:
    """Percent of errors (N,) under a tenth of the diameters (N,)."""
    errors, diameters = np.asarray(errors_m, float), np.asarray(diameters_m, float)
    return float(100.0 * (errors < RECALL_FRACTION * diameters).mean())


def auc(errors_m: Float) -> float:
    """Area under the accuracy-threshold curve from 0 to 0.1 m, percent: the mean of max(0, 1 - e / 0.1)."""
    errors = np.asarray(errors_m, dtype=np.float64)
    return float(100.0 * np.maximum(0.0, 1.0 - errors / AUC_LIMIT_M).mean())


def auc_voc(errors_m: Float) -> float:
    """The same area as the YCB-Video toolbox sums it (`VOCap`, in steps up to each next error), percent.

    Each step takes the accuracy at its right end, so the area is a little larger than `auc`; of several
    equal errors the first counts, as in the toolbox."""
    errors = np.sort(np.asarray(errors_m, dtype=np.float64))
    accuracy = np.arange(1, len(errors) + 1) / len(errors)
    kept = errors <= AUC_LIMIT_M
    if not kept.any():
        return 0.0
    at = np.concatenate([[0.0], errors[kept], [AUC_LIMIT_M]])
    height = np.concatenate([[0.0], accuracy[kept], [accuracy[kept][-1]]])
    steps = np.flatnonzero(at[1:] != at[:-1]) + 1
    return float(100.0 / AUC_LIMIT_M * np.sum((at[steps] - at[steps - 1]) * height[steps]))


def accuracy_curve(errors_m: Float, thresholds_m: Float) -> Float64:
    """Percent of errors (N,) at or under each threshold (M,)."""
    errors = np.sort(np.asarray(errors_m, dtype=np.float64))
    counts = np.searchsorted(errors, np.asarray(thresholds_m, float), side="right")
    return np.asarray(100.0 * counts / max(1, len(errors)))


def expected_calibration_error(quality: Float, right: Bool) -> float | None:
    """Mean distance of stated quality (N,) 0..1 and share of right poses (N,), over ten bins of equal count.

    A fraction, 0..1; None without poses. Bins are weighted by their counts where N does not divide by ten."""
    if not len(quality):
        return None
    stated, true, count = reliability_bins(quality, right, _CALIBRATION_BINS)
    return float((np.abs(stated - true) * count).sum() / count.sum())


def pose_scores(add_m: Float, adds_m: Float, diameters_m: Float) -> dict[str, Float64]:
    """What the four figures are the means of: a number for each of N poses, percent."""
    scores: dict[str, Float64] = {}
    for name, errors_m in (("add", add_m), ("adds", adds_m)):
        errors = np.asarray(errors_m, np.float64)
        right = errors < RECALL_FRACTION * np.asarray(diameters_m, np.float64)
        scores[f"recall_{name}"] = np.where(right, 100.0, 0.0)
        scores[f"auc_{name}"] = np.asarray(100.0 * np.maximum(0.0, 1.0 - errors / AUC_LIMIT_M), np.float64)
    return scores


def four_figures(add_m: Float, adds_m: Float, diameters_m: Float) -> dict[str, float | None]:
    """`recall_add`, `recall_adds`, `auc_add`, `auc_adds` of N poses, percent; None when N is 0."""
    if not len(add_m):
        return dict.fromkeys(FIGURES)
    return {name: float(each.mean()) for name, each in pose_scores(add_m, adds_m, diameters_m).items()}
