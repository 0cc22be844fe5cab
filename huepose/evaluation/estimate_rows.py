"""The rows of a single-frame evaluation, and their summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from huepose.believe.quality import QualityTerms
from huepose.evaluation import metrics
from huepose.evaluation.bop_errors import BopScore, average_recalls
from huepose.evaluation.summary import Figures, Row, grouped, mean_figures, pose_figures, pose_intervals
from huepose.evaluation.targets import PoseError
from huepose.geometry.arrays import Float64
from huepose.geometry.box import Box


@dataclass(frozen=True, eq=False)
class EstimateRow:
    """One ground-truth instance and its estimate. T_cam_obj (4, 4): metres, or None.

    seconds: wall time of the whole frame with all its objects; box: of the query, x y w h; terms: of the
    quality, None if there was nothing to judge; alternatives: the probabilities of the other poses, and
    whether each is right; reason: why no pose was found, empty if one was; bop: scores of the BOP
    challenge, None if not computed."""

    scene: str
    image: int
    instance: int
    object: int | str
    visib_fract: float | None
    T_cam_obj: Float64 | None
    error: PoseError
    diameter_m: float
    quality: float
    state: str
    seconds: float
    seed: int
    box: Box | None
    terms: QualityTerms | None = None
    alternatives: tuple[tuple[float, bool], ...] = ()
    reason: str = ""
    bop: BopScore | None = None

    def as_json(self) -> dict[str, Any]:
        """The row in its file form."""
        record = {name: value for name, value in vars(self).items() if name not in ("error", "bop")}
        record |= {
            "found": self.T_cam_obj is not None,
            "reason": self.reason or None,
            "add_m": self.error.add_m,
            "adds_m": self.error.adds_m,
            "add_official_m": self.error.official_add_m,
            "right": self.error.right,
            "box": None if self.box is None else list(self.box),
            "terms": None if self.terms is None else asdict(self.terms),
            "alternatives": [{"probability": p, "right": right} for p, right in self.alternatives],
        }
        return record if self.bop is None else record | {"bop": self.bop.as_json()}


@dataclass(frozen=True, eq=False)
class FalsePose:
    """A false positive: a pose of no ground-truth instance."""

    scene: str
    image: int
    object: int | str
    T_cam_obj: Float64
    quality: float
    state: str
    seed: int
    terms: QualityTerms | None = None

    def as_json(self) -> dict[str, Any]:
        """The pose in its file form."""
        return {**vars(self), "terms": None if self.terms is None else asdict(self.terms)}


@dataclass(frozen=True, eq=False)
class EstimateResult:
    """All rows of all seeds. skipped_no_bundle: number of labels without a reference model; frames: number of
    evaluated images, also of those without rows; None if unknown."""

    rows: Sequence[EstimateRow]
    false: Sequence[FalsePose]
    skipped_no_bundle: int
    boxes: str
    masks: str
    seeds: Sequence[int]
    frames: int | None = None

    def summary(self) -> dict[str, Any]:
        """The figures in percent, see `summary_of`."""
        summary: dict[str, Any] = self.as_json()["summary"]
        return summary

    def as_json(self) -> dict[str, Any]:
        """The result file."""
        rows, false = [row.as_json() for row in self.rows], [pose.as_json() for pose in self.false]
        settings = {
            "skipped_no_bundle": self.skipped_no_bundle,
            "frames": self.frames,
            "boxes": self.boxes,
            "masks": self.masks,
            "seed": self.seeds[0] if len(self.seeds) == 1 else list(self.seeds),
        }
        return {"summary": summary_of(rows, false, settings), "rows": rows, "false": false}


def summary_of(rows: Sequence[Row], false: Sequence[Row] = (), settings: Row | None = None) -> dict[str, Any]:
    """The figures of rows and false poses in their file form, in percent (`ece` is a fraction). Several seeds
    are averaged. BOP's AR is given if all rows (of an object, or of all) have BOP's errors. interval95: the
    95 % intervals of a bootstrap over frames, with their boxes of all seeds."""
    by_seed = {
        seed: _figures(own, [pose for pose in false if pose["seed"] == seed])
        for seed, own in grouped(rows, lambda row: row["seed"]).items()
    }
    seeds = max(1, len(by_seed))
    objects = grouped(rows, lambda row: row["object"])
    per_object = {
        number: {"instances": len(objects[number]) // seeds, **_pose_figures(objects[number])}
        for number in sorted(objects, key=lambda number: (str(type(number)), number))
    }
    return {
        "instances": len(rows) // seeds,
        "objects": len(per_object),
        **(settings or {}),
        **mean_figures(by_seed.values()),
        "false_poses": len(false) / seeds,
        "per_object": per_object,
        "interval95": pose_intervals(rows, [frame_of(row) for row in rows]),
        "by_seed": by_seed,
    }


def frame_of(row: Row) -> tuple[str, int]:
    """Scene and image of a row."""
    return row["scene"], row["image"]


def _pose_figures(rows: Sequence[Row]) -> Figures:
    official, bop = pose_figures(rows, "add_official_m"), [row["bop"] for row in rows if "bop" in row]
    return {
        **pose_figures(rows),
        "recall_add_official": official["recall_add"],
        "auc_add_official": official["auc_add"],
        **(average_recalls(bop) if bop and len(bop) == len(rows) else {}),
    }


def _figures(rows: Sequence[Row], false: Sequence[Row]) -> Figures:
    found = [*(row for row in rows if row["found"]), *false]
    seconds = list({frame_of(row): row["seconds"] for row in rows}.values())
    return {
        **_pose_figures(rows),
        "ece": metrics.expected_calibration_error(
            np.array([row["quality"] for row in found]),
            np.array([row.get("right", False) for row in found], dtype=bool),
        ),
        "seconds_per_frame_p50": float(np.median(seconds)) if seconds else None,
    }
