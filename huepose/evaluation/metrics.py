"""Pose errors and figures computed from them. Pure functions on arrays; errors in metres, figures in percent.

A missing pose has the error inf: it is wrong in recall and 0 in AUC.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from huepose.drawing.plots import reliability_bins
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float64

AUC_LIMIT_M = 0.1
"""Largest error in the area under the curve of ADD (Xiang et al., PoseCNN, RSS 2018)."""

RECALL_FRACTION = 0.1
"""Share of the diameter: a pose with a smaller ADD is right (Hinterstoisser et al., ACCV 2012)."""

FIGURES = ("recall_add", "recall_adds", "auc_add", "auc_adds")


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

    tree: a cKDTree of `points_obj`. The truth is transformed into the estimate's object frame, which does not
    change distances, so one tree serves all poses of a model."""
    T_estimate_truth = se3.inverse(T_estimate) @ T_truth
    tree = cKDTree(points_obj) if tree is None else tree
    distances, _ = tree.query(se3.apply(T_estimate_truth, points_obj))
    return float(distances.mean())


def auc_voc(errors_m: Float) -> float:
    """AUC as in the YCB-Video toolbox (`VOCap`: a sum of steps from one error to the next), percent.

    Each step takes the accuracy at its right end, so the area is a little larger than in `pose_scores`. Of
    several equal errors the first counts, as in the toolbox."""
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
    """Mean difference between stated quality (N,) 0..1 and share of right poses, over ten bins of equal
    count.

    A fraction, 0..1; None without poses. Bins are weighted by their counts where N does not divide by ten."""
    if not len(quality):
        return None
    stated, true, count = reliability_bins(quality, right)
    return float((np.abs(stated - true) * count).sum() / count.sum())


def pose_scores(add_m: Float, adds_m: Float, diameters_m: Float) -> dict[str, Float64]:
    """For each figure one number for each of N poses, percent; the figure is their mean. AUC is the area
    under the accuracy-threshold curve from 0 to 0.1 m, which is the mean of max(0, 1 - e / 0.1)."""
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


ROFT_FIGURES = ("rmse_cm", "rmse_deg", "rmse_cm_s", "rmse_deg_s")


def roft_figures(
    poses: Sequence[Float64 | None],
    truths: Sequence[Float64 | None],
    stamps_ns: Sequence[int],
    velocities: Sequence[Float64 | None] | None = None,
) -> dict[str, float | None]:
    """`rmse_cm`, `rmse_deg`, `rmse_cm_s`, `rmse_deg_s` of the frames of one track, in order of time.

    poses, truths: T_cam_obj (4, 4), None where there is none; a missing pose is replaced by the last one.
    velocities (6,): of the object's origin and angular, camera axes, per second, by default from the last
    two poses. The true velocity is that between the frame before and the frame after. Frames before the
    first pose are left out. A figure is None if no frame counts.
    """
    held = _held(poses)
    stated = list(velocities) if velocities is not None else [None] * len(held)
    errors: list[tuple[float, float]] = []
    speed_errors: list[tuple[float, float]] = []
    for i, (pose, truth) in enumerate(zip(held, truths, strict=True)):
        if pose is None or truth is None:
            continue
        errors.append(_lengths(se3.difference(truth, pose)))
        true_speed = _speed(truths, stamps_ns, i - 1, i + 1)
        speed = stated[i] if stated[i] is not None else _speed(held, stamps_ns, i - 1, i)
        if true_speed is not None and speed is not None:
            speed_errors.append(_lengths(np.asarray(speed) - true_speed))
    values = [*_rmse(errors), *_rmse(speed_errors)]
    return dict(zip(ROFT_FIGURES, values, strict=True))


def _held(poses: Sequence[Float64 | None]) -> list[Float64 | None]:
    last, held = None, []
    for pose in poses:
        last = pose if pose is not None else last
        held.append(last)
    return held


def _speed(
    poses: Sequence[Float64 | None], stamps_ns: Sequence[int], before: int, after: int
) -> Float64 | None:
    """Mean velocity (6,) between two frames, None if one of them has no pose or the time does not advance."""
    if before < 0 or after >= len(poses) or stamps_ns[after] <= stamps_ns[before]:
        return None
    start, end = poses[before], poses[after]
    if start is None or end is None:
        return None
    return np.asarray(se3.difference(start, end) / (1e-9 * (stamps_ns[after] - stamps_ns[before])))


def _lengths(delta: Float64) -> tuple[float, float]:
    """Centimetres and degrees of a difference (6,)."""
    return 100.0 * float(np.linalg.norm(delta[:3])), float(np.degrees(np.linalg.norm(delta[3:])))


def _rmse(pairs: Sequence[tuple[float, float]]) -> list[float | None]:
    if not pairs:
        return [None, None]
    return [float(v) for v in np.sqrt((np.array(pairs) ** 2).mean(0))]
