"""The rows of an evaluation of perception, and their summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from huepose.evaluation.bootstrap import Interval, frame_intervals
from huepose.evaluation.summary import grouped, mean_of
from huepose.geometry.box import Box

NOTHING = "nothing labelled"

FIRST = (1, 5, 20)
"""Numbers of first proposals of an object for which recall is given."""


@dataclass(frozen=True, eq=False)
class PerceptionRow:
    """One labelled instance. rank: of the first proposal whose box has an IoU of 0.5 or more with the
    label's, from 1; best_iou: of all proposals; mask_iou, final_mask_iou: IoU with the visible mask of the
    segmenter's first mask and of the estimator's final mask, in a disturbed true box, None if not measured;
    quality: of the kept pose that finds it, None if none does."""

    scene: str
    image: int
    instance: int
    object: int | str
    name: str
    visib_fract: float | None
    box: Box
    rank: int | None
    best_iou: float
    mask_iou: float | None
    final_mask_iou: float | None
    quality: float | None

    @property
    def found(self) -> bool:
        """A kept pose has the label's box."""
        return self.quality is not None

    def as_json(self) -> dict[str, Any]:
        """The row in its file form."""
        return {
            **vars(self),
            "box": list(self.box),
            "found": self.found,
            "reason": None if self.found else self._why_lost(),
            "quality": self.quality or 0.0,
        }

    def _why_lost(self) -> str:
        """Why no kept pose has the label's box, in one sentence."""
        if self.rank is None:
            return f"No proposal has its box; the best one has an IoU of {self.best_iou:.2f} with it."
        return f"Proposal {self.rank} of the object has its box, but no pose there is kept."


@dataclass(frozen=True, eq=False)
class FalseBox:
    """A false positive: a kept pose that is on no label of its object. shown: the labelled object that is
    there instead, None if there is none."""

    scene: str
    image: int
    object: int | str
    name: str
    box: Box
    quality: float
    shown: str | None

    def as_json(self) -> dict[str, Any]:
        """The box in its file form."""
        return {**vars(self), "box": list(self.box)}


@dataclass(frozen=True, eq=False)
class FrameFigures:
    """One frame. detector_s: wall time of the detector; seconds: of detector and estimator."""

    scene: str
    image: int
    rows: Sequence[PerceptionRow]
    false: Sequence[FalseBox]
    detector_s: float
    seconds: float


@dataclass(frozen=True, eq=False)
class PerceptionResult:
    """All frames; asked_for: number of objects that were searched for in each frame."""

    frames: Sequence[FrameFigures]
    asked_for: int

    def as_json(self) -> dict[str, Any]:
        """Summary, rows and false boxes."""
        rows = [row for frame in self.frames for row in frame.rows]
        false = [box for frame in self.frames for box in frame.false]
        return {
            "summary": self._summary(rows, false),
            "rows": [row.as_json() for row in rows],
            "false": [box.as_json() for box in false],
        }

    def _summary(self, rows: Sequence[PerceptionRow], false: Sequence[FalseBox]) -> dict[str, Any]:
        wrong = Counter(f.name for f in false)
        per_object = {
            name: {**_figures(own), "false_boxes": wrong.get(name, 0)}
            for name, own in sorted(grouped(rows, lambda r: r.name).items())
        }
        return {
            **_figures(rows),
            "false_boxes_per_frame": len(false) / len(self.frames),
            "seconds_per_frame_p50": float(np.median([f.seconds for f in self.frames])),
            "detector_seconds_per_frame_p50": float(np.median([f.detector_s for f in self.frames])),
            "interval95": self._intervals(rows),
            "frames": len(self.frames),
            "asked_for": self.asked_for,
            "per_object": per_object,
            "confusion": _confusion(rows, false),
        }

    def _intervals(self, rows: Sequence[PerceptionRow]) -> dict[str, Interval | None]:
        """Intervals of recall (over frames with labels) and of false boxes (over all frames)."""
        recall = {"recall_iou50": np.array([100.0 * row.found for row in rows])}
        per_frame = {"false_boxes_per_frame": np.array([float(len(frame.false)) for frame in self.frames])}
        return {
            **frame_intervals(recall, [(row.scene, row.image) for row in rows]),
            **frame_intervals(per_frame, [(frame.scene, frame.image) for frame in self.frames]),
        }


def _figures(rows: Sequence[PerceptionRow]) -> dict[str, Any]:
    return {
        "instances": len(rows),
        "recall_iou50": 100.0 * float(np.mean([r.found for r in rows])),
        "recall_at": {
            n: 100.0 * float(np.mean([r.rank is not None and r.rank <= n for r in rows])) for n in FIRST
        },
        "mask_iou": mean_of([r.mask_iou for r in rows]),
        "final_mask_iou": mean_of([r.final_mask_iou for r in rows]),
    }


def _confusion(rows: Sequence[PerceptionRow], false: Sequence[FalseBox]) -> dict[str, dict[str, int]]:
    """Confusion matrix: counts[found object][labelled object], with the diagonal."""
    counts: dict[str, Counter[str]] = {}
    for row in rows:
        if row.found:
            counts.setdefault(row.name, Counter())[row.name] += 1
    for box in false:
        counts.setdefault(box.name, Counter())[box.shown or NOTHING] += 1
    return {name: dict(sorted(line.items())) for name, line in sorted(counts.items())}
