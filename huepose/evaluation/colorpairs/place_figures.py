"""Figures of the places of colour pairs, and what each is above or under the method as it ships.

What is compared are answers to the same questions, so the interval of a difference is that of the mean of
the differences, over draws of frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from huepose.evaluation import metrics
from huepose.evaluation.bootstrap import Interval, frame_intervals
from huepose.evaluation.colorpairs.place_study import PlaceRow, Question
from huepose.evaluation.colorpairs.places import SHIPPED
from huepose.evaluation.summary import grouped, table
from huepose.geometry.arrays import Float64

ALL = "all sets"


@dataclass(frozen=True)
class PlaceFigures:
    """Recall and AUC in percent; ms: mean CPU time an object; more_add, more_auc: what ADD recall and its AUC
    are above those of the method as it ships, with the interval that holds 95 % of draws of frames; mended,
    spoiled: questions that only the place, only the method as it ships answers rightly (ADD)."""

    set: str
    place: str
    questions: int
    recall_add: float
    recall_adds: float
    auc_add: float
    auc_adds: float
    ms: float
    more_add: float
    more_add95: Interval
    more_auc: float
    more_auc95: Interval
    mended: int
    spoiled: int


def figures_of(questions: Sequence[Question]) -> list[PlaceFigures]:
    """Figures of each place on each set, and over all of them where there are several."""
    by_set = grouped(questions, lambda q: q.set)
    groups: Mapping[str, Sequence[Question]] = {**by_set, **({ALL: questions} if len(by_set) > 1 else {})}
    return [f for name, mine in groups.items() for f in _of_set(name, mine)]


def _of_set(name: str, questions: Sequence[Question]) -> list[PlaceFigures]:
    places = [p for p in questions[0].answers if all(p in q.answers for q in questions)]
    diameters = np.array([q.diameter_m for q in questions])
    frames = [(q.set, q.scene, q.image) for q in questions]
    base_right, base_auc = _values([q.answers[SHIPPED] for q in questions], diameters)
    out = []
    for place in places:
        rows = [q.answers[place] for q in questions]
        right, auc = _values(rows, diameters)
        more = {"add": right - base_right, "auc": auc - base_auc}
        spans = frame_intervals(more, frames)
        add, adds = np.array([r.add_m for r in rows]), np.array([r.adds_m for r in rows])
        four = metrics.four_figures(add, adds, diameters)
        recall, recall_s, area, area_s = (float(value or 0.0) for value in four.values())
        ms = 1e3 * float(np.mean([r.seconds for r in rows]))
        out.append(
            PlaceFigures(
                name,
                place,
                len(rows),
                recall,
                recall_s,
                area,
                area_s,
                ms,
                float(more["add"].mean()),
                spans["add"],
                float(more["auc"].mean()),
                spans["auc"],
                int((more["add"] > 0).sum()),
                int((more["add"] < 0).sum()),
            )
        )
    return out


def place_lines(figures: Sequence[PlaceFigures]) -> str:
    """A table for each set."""
    header = ["place", "n", "ADD", "ADD-S", "AUC", "AUC-S", "ms", "more ADD", "mended/spoiled", "more AUC"]
    out = []
    for name, mine in grouped(figures, lambda f: f.set).items():
        cells = [
            [
                f.place,
                f.questions,
                f.recall_add,
                f.recall_adds,
                f.auc_add,
                f.auc_adds,
                f.ms,
                f"{f.more_add:+.1f} ({f.more_add95[0]:+.1f} to {f.more_add95[1]:+.1f})",
                f"{f.mended}/{f.spoiled}",
                f"{f.more_auc:+.2f} ({f.more_auc95[0]:+.2f} to {f.more_auc95[1]:+.2f})",
            ]
            for f in mine
        ]
        out += [f"-- {name}", table(header, cells)]
    return "\n".join(out)


def question_entry(question: Question) -> dict[str, Any]:
    """A question as JSON has it."""
    return asdict(question)


def question_of(entry: Mapping[str, Any]) -> Question:
    """The question that JSON has; null is inf."""
    answers = {
        place: PlaceRow(**{k: np.inf if v is None else v for k, v in row.items()})
        for place, row in entry["answers"].items()
    }
    return Question(**{**entry, "answers": answers})


def _values(rows: Sequence[PlaceRow], diameters: Float64) -> tuple[Float64, Float64]:
    """By row, in percent: whether ADD is right (N,), and its share of the AUC (N,)."""
    add = np.array([r.add_m for r in rows])
    right = np.where(add < metrics.RECALL_FRACTION * diameters, 100.0, 0.0)
    return right, np.asarray(100.0 * np.maximum(0.0, 1.0 - add / metrics.AUC_LIMIT_M))
