"""Calibration of quality: estimates with ground truth, and how well their stated quality agrees with it."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from huepose.believe.quality import QualityTerms
from huepose.datasets import files
from huepose.evaluation import metrics
from huepose.evaluation.summary import Row
from huepose.geometry.arrays import Bool, Float64, Int64
from huepose.support.errors import InputError

FALSE_WEIGHT = 0.05
"""Weight of a pose where the object is not present; one where it is present has weight 1. Presence is a
separate question, and many such poses would make every doubtful pose look wrong."""


@dataclass(frozen=True, eq=False)
class Judged:
    """N estimates with ground truth. terms: of their quality; which (N,): index of the right answer, 0 for
    the pose itself, -1 if none is right; placed (N,): the pose is on the object, at whatever rotation;
    frames: the frame of each; instances: the instance of each, which may occur several times; stated (N,):
    the published quality; weights (N,); missed: number of further instances without a pose."""

    terms: Sequence[QualityTerms]
    which: Int64
    placed: Bool
    frames: Sequence[tuple[Any, ...]]
    instances: Sequence[tuple[Any, ...]]
    stated: Float64
    weights: Float64
    missed: int = 0

    @property
    def right(self) -> Bool:
        """Whether the pose itself is right (N,)."""
        return np.asarray(self.which == 0)

    def __add__(self, other: Judged) -> Judged:
        return Judged(
            [*self.terms, *other.terms],
            np.concatenate([self.which, other.which]),
            np.concatenate([self.placed, other.placed]),
            [*self.frames, *other.frames],
            [*self.instances, *other.instances],
            np.concatenate([self.stated, other.stated]),
            np.concatenate([self.weights, other.weights]),
            self.missed + other.missed,
        )

    def only(self, chosen: Bool) -> Judged:
        """The estimates in a mask (N,), with `missed` 0."""
        keep = np.flatnonzero(chosen).tolist()
        return Judged(
            [self.terms[k] for k in keep],
            self.which[keep],
            self.placed[keep],
            [self.frames[k] for k in keep],
            [self.instances[k] for k in keep],
            self.stated[keep],
            self.weights[keep],
        )


@dataclass(frozen=True)
class Worth:
    """Figures of a quality on some estimates. ece: calibration error over ten bins of equal count; chance:
    the same if every stated quality were true, mean and 95 % quantile, see `by_chance`; precision: share of
    right poses among those at or above the level, None if there are none; coverage: share of all instances
    at or above it; poses, right: counts; found: share of instances with a pose."""

    ece: float | None
    chance: tuple[float, float] | None
    precision: float | None
    coverage: float
    poses: int
    right: int
    found: float


def read_judged(path: Path | str) -> Judged:
    """The found poses of a result file of `huepose eval estimate`. Poses that belong to no label count as
    wrong. Raises InputError."""
    rows, false = read_rows(path)
    found = [row for row in rows if row.get("found")]
    return replace(judged(found, false, path), missed=len(rows) - len(found))


def judged(found: Sequence[Row], false: Sequence[Row], path: Path | str) -> Judged:
    """Estimates from rows of a file. found: poses of labels; false: poses of no label. Raises InputError."""
    every = [*found, *false]
    return Judged(
        [_quality_terms(row, path) for row in every],
        np.array([_which(row) for row in found] + [-1] * len(false), dtype=np.int64),
        np.array([_placed(row) for row in found] + [False] * len(false)),
        [_frame_key(row, path) for row in every],
        [(*_frame_key(row, path), row.get("instance", k)) for k, row in enumerate(every)],
        np.array([float(row["quality"]) for row in every]),
        np.array([1.0] * len(found) + [FALSE_WEIGHT] * len(false)),
    )


def read_rows(path: Path | str) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Rows and false poses of a result file of `huepose eval estimate`. Raises InputError."""
    record = files.read_json(Path(path), "Make it with `huepose eval estimate --json`.")
    rows, false = files.field(record, "rows", path), record.get("false", [])
    if not rows and not false:
        raise InputError(path, found="no pose", expected="a result of `huepose eval estimate`")
    return rows, false


def _frame_key(row: Row, path: Path | str) -> tuple[str, str, int]:
    """The frame of a row: file, scene, image."""
    return str(path), str(row["scene"]), int(row["image"])


def _quality_terms(row: Row, path: Path | str) -> QualityTerms:
    """The terms of a row's quality. Raises InputError if the file does not have them."""
    try:
        return QualityTerms(**{**row["terms"], "gaps": tuple(row["terms"]["gaps"])})
    except (TypeError, KeyError):
        raise InputError(
            path,
            found="poses without the terms of their quality",
            expected="a result of `huepose eval estimate`",
            fix="Make it again.",
        ) from None


def _which(row: Row) -> int:
    """Index of the first right answer, -1 if none is right."""
    chances = [row["right"], *(other["right"] for other in row.get("alternatives", []))]
    return next((k for k, right in enumerate(chances) if right), -1)


def _placed(row: Row) -> bool:
    """The pose is right, or its ADD-S is under a tenth of the diameter."""
    return bool(row["right"] or row["adds_m"] < metrics.RECALL_FRACTION * row["diameter_m"])


def worth(quality: Float64, judged: Judged, level: float, found: Bool | None = None) -> Worth:
    """The figures of stated qualities (N,) at a level. found (N,): which count as found, by default all."""
    over = quality >= level
    total = len(quality) + judged.missed
    seen = len(quality) if found is None else int(found.sum())
    return Worth(
        metrics.expected_calibration_error(quality, judged.right),
        by_chance(quality, judged.instances),
        float(judged.right[over].mean()) if over.any() else None,
        float(over.sum()) / max(1, total),
        total,
        int(judged.right.sum()),
        seen / max(1, total),
    )


CHANCE_DRAWS = 400
"""Number of draws in `by_chance`: twenty of them are above its 95 % quantile."""


def by_chance(quality: Float64, instances: Sequence[Hashable]) -> tuple[float, float] | None:
    """The calibration error if all qualities (N,) were true: its mean and 95 % quantile over random draws;
    None without qualities. With few poses it is above 0 by chance. The same instance in several boxes is
    nearly always right in all or wrong in all: so one random number is drawn for each instance, and its
    poses are right where it is below their quality."""
    if not len(quality):
        return None
    number = {instance: k for k, instance in enumerate(dict.fromkeys(instances))}
    index = np.array([number[instance] for instance in instances])
    rng = np.random.default_rng(0)
    errors = [
        metrics.expected_calibration_error(quality, rng.random(len(number))[index] < quality) or 0.0
        for _ in range(CHANCE_DRAWS)
    ]
    return float(np.mean(errors)), float(np.quantile(errors, 0.95))
