"""Fitting quality: from estimates with known truth to a probability that a pose is right.

A logistic function of the features of `estimation.quality`, of largest likelihood under a small ridge, with
no negative factor, since each feature is made so that more of it means surer. What is reported of a fit is
measured on frames that it has not seen: the frames are dealt into folds, and each fold is judged by the fit
of the others.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from huepose.datasets import files
from huepose.estimation.quality import QualityFit, QualityTerms, features
from huepose.evaluation import metrics
from huepose.geometry.arrays import Bool, Float64
from huepose.support.errors import InputError

RIDGE = 2.0
"""Of the squared factors, each in units of its feature's spread, against the sum of log likelihoods."""

FEATURES: Mapping[str, Sequence[str]] = {
    "full": ("margin", "total", "color", "box_iou"),
    "colorpair": ("margin", "total", "box_iou", "depth_fit"),
}
"""By method, of `estimation.quality.features`: the fewest whose likelihood on frames that the fit has not
seen is as good as that of all (mean log loss of `full` 0.188 with these, 0.190 with all eleven)."""

FALSE_WEIGHT = 0.2
"""Of a pose in a box that holds another object: how often that happens is the detector's matter, and enough
of them would make every doubtful pose look false."""

LEVEL_SHARE = 0.99
FOLDS = 10
FEWEST = 50
"""Fewer poses than this over a level say nothing about 99 %."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Estimates with truth: terms; right (N,); frames: which frame each is of; stated (N,): the quality that
    was published for each; missed: how many more instances got no pose; weights (N,)."""

    terms: Sequence[QualityTerms]
    right: Bool
    frames: Sequence[Hashable]
    stated: Float64
    weights: Float64
    missed: int = 0

    def __add__(self, other: Judged) -> Judged:
        return Judged(
            [*self.terms, *other.terms],
            np.concatenate([self.right, other.right]),
            [*self.frames, *other.frames],
            np.concatenate([self.stated, other.stated]),
            np.concatenate([self.weights, other.weights]),
            self.missed + other.missed,
        )

    def only(self, chosen: Bool) -> Judged:
        """Those of a mask (N,); none counts as missed."""
        keep = np.flatnonzero(chosen).tolist()
        return Judged(
            [self.terms[k] for k in keep],
            self.right[keep],
            [self.frames[k] for k in keep],
            self.stated[keep],
            self.weights[keep],
        )


@dataclass(frozen=True)
class Worth:
    """What a quality is worth on some estimates. ece: calibration error over ten bins of equal count;
    precision: share right of those over the level, None where there are none; coverage: share of all
    instances that are over it; poses, right: counts."""

    ece: float | None
    precision: float | None
    coverage: float
    poses: int
    right: int


def read_judged(path: Path | str, absent: bool = False) -> Judged:
    """The found poses of a result file of `huepose eval estimate`, false ones included.

    absent: what was shown only looks like what was asked for, as a box with another print does: all poses are
    wrong. Raises InputError."""
    record = files.read_json(Path(path), "Make it with `huepose eval estimate --json`.")
    rows = files.field(record, "rows", path)
    false = record.get("false", [])
    found = [row for row in rows if row.get("found")]
    every = [*found, *false]
    if any(row.get("terms") is None for row in every) or not every:
        raise InputError(
            path,
            found="poses without the terms of their quality" if every else "no pose",
            expected="a result of `huepose eval estimate`",
            fix="Make it again.",
        )
    return Judged(
        [QualityTerms(**row["terms"]) for row in every],
        np.array([bool(row["right"]) and not absent for row in found] + [False] * len(false)),
        [(str(path), row["scene"], row["image"]) for row in every],
        np.array([float(row["quality"]) for row in every]),
        np.array([FALSE_WEIGHT if absent else 1.0] * len(found) + [FALSE_WEIGHT] * len(false)),
        0 if absent else len(rows) - len(found),
    )


def fit(judged: Judged, names: Sequence[str], alike: int = 0) -> QualityFit:
    """The fit on all of `judged`, its level from folds that their own fit has not seen.

    names: of the features to use; alike: so many poses at the end are of look-alikes, which are fitted to,
    but say nothing of how often one is right where the object is there: the level leaves them out. Raises
    InputError when all or none are right."""
    if judged.right.all() or not judged.right.any():
        raise InputError(
            "calibration",
            found=f"{int(judged.right.sum())} right of {len(judged.right)} poses",
            expected="right ones and wrong ones",
            fix="Use more or harder scenes.",
        )
    constant, factors = _logistic(_matrix(judged.terms, names), judged.right, judged.weights)
    shown = slice(len(judged.right) - alike)
    level = level_of(held_out(judged, names)[shown], judged.right[shown], judged.weights[shown])
    return QualityFit(constant, dict(zip(names, factors.tolist(), strict=True)), level)


def held_out(judged: Judged, names: Sequence[str], folds: int = FOLDS) -> Float64:
    """Quality (N,) of each pose by a fit that has not seen its frame."""
    frames = {frame: k for k, frame in enumerate(dict.fromkeys(judged.frames))}
    order = np.random.default_rng(0).permutation(len(frames))
    fold = order[[frames[frame] for frame in judged.frames]] % folds
    x = _matrix(judged.terms, names)
    result = np.zeros(len(x))
    for k in range(folds):
        mine = fold == k
        if not mine.any():
            continue
        others = judged.right[~mine]
        if others.all() or not others.any():
            result[mine] = others.mean() if len(others) else 0.5
            continue
        constant, factors = _logistic(x[~mine], others, judged.weights[~mine])
        result[mine] = _sigmoid(constant + x[mine] @ factors)
    return result


def level_of(
    quality: Float64, right: Bool, weights: Float64 | None = None, share: float = LEVEL_SHARE
) -> float:
    """The lowest quality such that of the poses with it or more the share `share` is right; quality (N,),
    right, weights (N,). Where there is none, or it stands for fewer than 50 poses: that of the 50 surest."""
    order = np.argsort(-quality, kind="stable")
    each = np.ones(len(order)) if weights is None else weights[order]
    true = np.cumsum(each * right[order]) / np.cumsum(each)
    good = np.flatnonzero(true >= share)
    good = good[good >= min(FEWEST, len(order)) - 1]
    last = int(good[-1]) if len(good) else min(FEWEST, len(order)) - 1
    return float(np.clip(quality[order[last]], 0.01, 0.999))


def worth(quality: Float64, judged: Judged, level: float) -> Worth:
    """What stated qualities (N,) are worth at a level."""
    over = quality >= level
    total = len(quality) + judged.missed
    return Worth(
        metrics.expected_calibration_error(quality, judged.right),
        float(judged.right[over].mean()) if over.any() else None,
        float(over.sum()) / max(1, total),
        total,
        int(judged.right.sum()),
    )


def stated_by(quality_fit: QualityFit, judged: Judged) -> Float64:
    """Quality (N,) by a fit."""
    return np.array([quality_fit(terms) for terms in judged.terms])


def as_json(quality_fit: QualityFit) -> dict[str, Any]:
    """The entry of `quality_fits.json`: factors of nothing are left out."""
    factors: Mapping[str, float] = quality_fit.factors
    return {
        "constant": round(quality_fit.constant, 4),
        "factors": {name: round(f, 4) for name, f in factors.items() if f > 1e-4},
        "level": round(quality_fit.level, 4),
    }


def _matrix(terms: Sequence[QualityTerms], names: Sequence[str]) -> Float64:
    rows = [features(t) for t in terms]
    return np.array([[row[name] for name in names] for row in rows])


def _logistic(x: Float64, right: Bool, weights: Float64) -> tuple[float, Float64]:
    """Constant and factors (K,) >= 0 of largest penalised likelihood; x (N, K), right, weights (N,)."""
    centre, spread = x.mean(0), np.maximum(x.std(0), 1e-6)
    z = (x - centre) / spread
    sign = np.where(right, 1.0, -1.0)

    def loss(p: Float64) -> tuple[float, Float64]:
        s = sign * (p[0] + z @ p[1:])
        pull = -weights * sign * _sigmoid(-s)
        slope = np.concatenate([[pull.sum()], pull @ z + RIDGE * p[1:]])
        return float((weights * np.logaddexp(0.0, -s)).sum() + 0.5 * RIDGE * (p[1:] ** 2).sum()), slope

    bounds = [(None, None), *[(0.0, None)] * x.shape[1]]
    found = minimize(loss, np.zeros(1 + x.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    factors = found[1:] / spread
    return float(found[0] - factors @ centre), np.asarray(factors)


def _sigmoid(x: Float64) -> Float64:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(x, -30.0, 30.0))))
