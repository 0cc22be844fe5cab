"""Estimates with known truth, as quality is fitted to them: what was seen, and which answer was right."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huepose.believe.quality import QualityTerms
from huepose.datasets import files
from huepose.evaluation import metrics
from huepose.geometry.arrays import Bool, Float64, Int64
from huepose.support.errors import InputError

FALSE_WEIGHT = 0.05
"""Of a pose where the object is not, against one where it is: whether it is there at all is a question of its
own, and enough of them would make every doubtful pose look false."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Estimates with truth: terms; which (N,): the number of the answer that is right, 0 the pose itself, -1
    none; placed (N,): whether the pose lies on the object, turned as it may be; frames: which frame each is
    of; instances: which object of which frame, however often it was asked for; stated (N,): the quality that
    was published for each; weights (N,); missed: how many more instances got no pose."""

    terms: Sequence[QualityTerms]
    which: Int64
    placed: Bool
    frames: Sequence[Hashable]
    instances: Sequence[Hashable]
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
        """Those of a mask (N,); none counts as missed."""
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


NONE = Judged([], np.zeros(0, np.int64), np.zeros(0, bool), [], [], np.zeros(0), np.zeros(0))


def read_judged(path: Path | str) -> Judged:
    """The found poses of a result file of `huepose eval estimate`; poses that belong to no label are none of
    them right. Raises InputError."""
    rows, false = _read(path)
    found = [row for row in rows if row.get("found")]
    every = [*found, *false]
    return Judged(
        [_terms(row, path) for row in every],
        np.array([_which(row) for row in found] + [-1] * len(false), dtype=np.int64),
        np.array([_placed(row) for row in found] + [False] * len(false)),
        [_frame(row, path) for row in every],
        [(*_frame(row, path), row.get("instance", k)) for k, row in enumerate(every)],
        np.array([float(row["quality"]) for row in every]),
        np.array([1.0] * len(found) + [FALSE_WEIGHT] * len(false)),
        len(rows) - len(found),
    )


def read_absent(path: Path | str) -> Judged:
    """All that was looked at where the object is not, found or not: none is right. Raises InputError."""
    rows, false = _read(path)
    every = [row for row in [*rows, *false] if row.get("terms") is not None]
    return Judged(
        [_terms(row, path) for row in every],
        np.full(len(every), -1, dtype=np.int64),
        np.zeros(len(every), bool),
        [_frame(row, path) for row in every],
        [(*_frame(row, path), row.get("instance", k)) for k, row in enumerate(every)],
        np.array([float(row["quality"]) for row in every]),
        np.full(len(every), FALSE_WEIGHT),
    )


def _read(path: Path | str) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    record = files.read_json(Path(path), "Make it with `huepose eval estimate --json`.")
    rows, false = files.field(record, "rows", path), record.get("false", [])
    if not rows and not false:
        raise InputError(path, found="no pose", expected="a result of `huepose eval estimate`")
    return rows, false


def _frame(row: Mapping[str, Any], path: Path | str) -> tuple[str, str, int]:
    return str(path), str(row["scene"]), int(row["image"])


def _terms(row: Mapping[str, Any], path: Path | str) -> QualityTerms:
    try:
        return QualityTerms(**{**row["terms"], "gaps": tuple(row["terms"]["gaps"])})
    except (TypeError, KeyError):
        raise InputError(
            path,
            found="poses without the terms of their quality",
            expected="a result of `huepose eval estimate`",
            fix="Make it again.",
        ) from None


def _which(row: Mapping[str, Any]) -> int:
    """The number of the first answer that is right, -1 for none."""
    chances = [row["right"], *(other["right"] for other in row.get("alternatives", []))]
    return next((k for k, right in enumerate(chances) if right), -1)


def _placed(row: Mapping[str, Any]) -> bool:
    """ADD-S under a tenth of the diameter."""
    return bool(row["right"] or row["adds_m"] < metrics.RECALL_FRACTION * row["diameter_m"])
