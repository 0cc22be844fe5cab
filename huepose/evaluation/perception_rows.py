"""The rows of an evaluation of perception, and their summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from huepose.estimation.types import PoseEstimate
from huepose.evaluation.bootstrap import Interval, frame_intervals
from huepose.evaluation.summary import grouped, mean_of
from huepose.geometry.box import Box

NOTHING = "nothing labelled"


@dataclass(frozen=True, eq=False)
class PerceptionRow:
    """One labelled instance. rank: of the first proposal whose box overlaps the label's by IoU 0.5, from 1;
    best_iou: of all proposals; mask_iou, final_mask_iou: of the segmenter's first mask and of the mask that
    the estimator ends with, in a disturbed true box, with the visible mask; None where not measured."""

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


@dataclass(frozen=True, eq=False)
class FalseBox:
    """A standing pose that is no label's of its object; shown: the labelled object that is there instead."""

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


Verdict = Callable[[Sequence[str]], tuple[dict[int, PoseEstimate], list[FalseBox]]]


@dataclass(frozen=True, eq=False)
class FrameFigures:
    """One frame. asked: the names that were asked for; verdict: of a choice of objects' names, the standing
    poses by instance, and the false boxes; detector_s, seconds: wall time of the detector, and with the
    estimator."""

    scene: str
    image: int
    rows: Sequence[PerceptionRow]
    asked: Sequence[str]
    verdict: Verdict
    detector_s: float
    seconds: float


@dataclass(frozen=True, eq=False)
class PerceptionResult:
    """All frames, and what was asked for in each of them."""

    frames: Sequence[FrameFigures]
    names: Sequence[str]
    onboarded: Sequence[int]
    subsets: int
    seed: int

    def as_json(self, proposals: Sequence[int]) -> dict[str, Any]:
        """Summary, rows and false boxes; recall_at for so many proposals of an object."""
        rows, false = [], []
        found: dict[int, bool] = {}
        for frame in self.frames:
            taken, wrong = frame.verdict(self.names)
            false += wrong
            for row in frame.rows:
                pose = taken.get(row.instance)
                found[id(row)] = pose is not None
                rows.append(
                    {
                        **vars(row),
                        "box": list(row.box),
                        "found": pose is not None,
                        "reason": None if pose is not None else _why_lost(row),
                        "quality": 0.0 if pose is None else pose.quality,
                    }
                )
        return {
            "summary": self._summary(proposals, found, false),
            "rows": rows,
            "false": [f.as_json() for f in false],
        }

    def _summary(
        self, proposals: Sequence[int], found: dict[int, bool], false: Sequence[FalseBox]
    ) -> dict[str, Any]:
        every = [row for frame in self.frames for row in frame.rows]
        wrong = Counter(f.name for f in false)
        per_object = {
            name: {**_figures(rows, proposals, found), "false_boxes": wrong.get(name, 0)}
            for name, rows in sorted(grouped(every, lambda r: r.name).items())
        }
        return {
            **_figures(every, proposals, found),
            "false_boxes_per_frame": len(false) / len(self.frames),
            "seconds_per_frame_p50": float(np.median([f.seconds for f in self.frames])),
            "detector_seconds_per_frame_p50": float(np.median([f.detector_s for f in self.frames])),
            "interval95": self._intervals(found, false),
            "frames": len(self.frames),
            "asked_for": len(self.names),
            "per_object": per_object,
            "by_onboarded": {n: self._with(n) for n in self.onboarded if n <= len(self.names)},
            "confusion": _confusion(every, found, false),
        }

    def _intervals(self, found: dict[int, bool], false: Sequence[FalseBox]) -> dict[str, Interval]:
        """Of recall over the frames with labels, of false boxes over all frames."""
        rows = [row for frame in self.frames for row in frame.rows]
        wrong = Counter((f.scene, f.image) for f in false)
        frames = [(frame.scene, frame.image) for frame in self.frames]
        recall = {"recall_iou50": np.array([100.0 * found[id(row)] for row in rows])}
        per_frame = {"false_boxes_per_frame": np.array([float(wrong[key]) for key in frames])}
        return {
            **frame_intervals(recall, [(row.scene, row.image) for row in rows]),
            **frame_intervals(per_frame, frames),
        }

    def _with(self, count: int) -> dict[str, float | None]:
        """Recall and false boxes when only `count` of the objects are onboarded: mean over random choices."""
        rng = np.random.default_rng([self.seed, count])
        recalls, wrong = [], []
        for _ in range(1 if count == len(self.names) else self.subsets):
            names = list(rng.permutation(np.array(self.names))[:count])
            hits, total, false = 0, 0, 0
            for frame in self.frames:
                taken, other = frame.verdict(names)
                wanted = [row for row in frame.rows if row.name in names]
                hits += sum(row.instance in taken for row in wanted)
                total += len(wanted)
                false += len(other)
            recalls.append(100.0 * hits / total if total else None)
            wrong.append(false / len(self.frames))
        return {"recall_iou50": mean_of(recalls), "false_boxes_per_frame": mean_of(wrong)}


def _why_lost(row: PerceptionRow) -> str:
    """Why no standing pose has the label's box, in one sentence."""
    if row.rank is None:
        return f"No proposal has its box; the best one overlaps it by IoU {row.best_iou:.2f}."
    return f"Proposal {row.rank} of the object has its box, and no pose stands there."


def _figures(
    rows: Sequence[PerceptionRow], proposals: Sequence[int], found: dict[int, bool]
) -> dict[str, Any]:
    return {
        "instances": len(rows),
        "recall_iou50": 100.0 * float(np.mean([found[id(r)] for r in rows])),
        "recall_at": {
            n: 100.0 * float(np.mean([r.rank is not None and r.rank <= n for r in rows])) for n in proposals
        },
        "mask_iou": mean_of([r.mask_iou for r in rows]),
        "final_mask_iou": mean_of([r.final_mask_iou for r in rows]),
    }


def _confusion(
    rows: Sequence[PerceptionRow], found: dict[int, bool], false: Sequence[FalseBox]
) -> dict[str, dict[str, int]]:
    """What was taken for what: found[taken for][really there], the diagonal included."""
    counts: dict[str, Counter[str]] = {}
    for row in rows:
        if found[id(row)]:
            counts.setdefault(row.name, Counter())[row.name] += 1
    for box in false:
        counts.setdefault(box.name, Counter())[box.shown or NOTHING] += 1
    return {name: dict(sorted(line.items())) for name, line in sorted(counts.items())}
