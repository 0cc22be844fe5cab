"""The rows of a single-frame evaluation, and their summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from huepose.believe.quality import QualityTerms
from huepose.evaluation import metrics
from huepose.evaluation.bootstrap import Interval, frame_intervals
from huepose.evaluation.bop_errors import BopScore, average_recalls
from huepose.evaluation.summary import Figures, grouped, mean_figures
from huepose.evaluation.targets import PoseError
from huepose.geometry.arrays import Float64
from huepose.geometry.box import Box

_FIGURES = (*metrics.FIGURES, "recall_add_official", "auc_add_official")


@dataclass(frozen=True, eq=False)
class EstimateRow:
    """One ground-truth instance and what was estimated for it; T_cam_obj (4, 4) metres or None.

    seconds: wall time of the whole frame, all its objects; box: what the estimator was given, x y w h;
    terms: what the quality was made of, None where nothing could be looked at; alternatives: the other
    answers' probabilities, and whether each is right; reason: why nothing was found, empty where something
    was; bop: by the errors of the BOP challenge, None where not measured."""

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
    """A pose that belongs to no ground-truth instance."""

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
    """All rows of all seeds. skipped_no_bundle: labels without a reference model, of one seed."""

    rows: Sequence[EstimateRow]
    false: Sequence[FalsePose]
    skipped_no_bundle: int
    boxes: str
    masks: str
    seeds: Sequence[int]

    def summary(self) -> dict[str, Any]:
        """The figures in percent; `ece` is a fraction; several seeds are averaged. interval95: where
        the figures lie in 95 % of draws of frames."""
        by_seed = {
            seed: _figures(
                [r for r in self.rows if r.seed == seed], [f for f in self.false if f.seed == seed]
            )
            for seed in self.seeds
        }
        per_object = {
            number: {"instances": len(rows) // max(1, len(self.seeds)), **_pose_figures(rows)}
            for number, rows in sorted(
                grouped(self.rows, lambda r: r.object).items(), key=lambda item: (str(type(item[0])), item[0])
            )
        }
        return {
            "instances": len(self.rows) // max(1, len(self.seeds)),
            "objects": len(per_object),
            "skipped_no_bundle": self.skipped_no_bundle,
            "boxes": self.boxes,
            "masks": self.masks,
            "seed": self.seeds[0] if len(self.seeds) == 1 else list(self.seeds),
            **mean_figures(by_seed.values()),
            "false_poses": len(self.false) / max(1, len(self.seeds)),
            "per_object": per_object,
            "object_mean": mean_figures(
                {key: figures[key] for key in _FIGURES} for figures in per_object.values()
            ),
            "interval95": _intervals(self.rows),
            "by_seed": by_seed,
        }

    def as_json(self) -> dict[str, Any]:
        """The result file."""
        return {
            "summary": self.summary(),
            "rows": [row.as_json() for row in self.rows],
            "false": [pose.as_json() for pose in self.false],
        }


def _intervals(rows: Sequence[EstimateRow]) -> dict[str, Interval]:
    """The four figures' intervals over frames; a frame's boxes of all seeds count as one frame."""
    values = metrics.pose_scores(
        np.array([r.error.add_m for r in rows]),
        np.array([r.error.adds_m for r in rows]),
        np.array([r.diameter_m for r in rows]),
    )
    return frame_intervals(values, [(r.scene, r.image) for r in rows])


def _pose_figures(rows: Sequence[EstimateRow]) -> Figures:
    diameters = np.array([r.diameter_m for r in rows])
    add = np.array([r.error.add_m for r in rows])
    adds = np.array([r.error.adds_m for r in rows])
    official = np.array([r.error.official_add_m for r in rows])
    measured = [row.bop.as_json() for row in rows if row.bop is not None]
    return {
        **metrics.four_figures(add, adds, diameters),
        "recall_add_official": metrics.recall(official, diameters) if len(rows) else None,
        "auc_add_official": metrics.auc(official) if len(rows) else None,
        "auc_voc_add": metrics.auc_voc(add) if len(rows) else None,
        "auc_voc_adds": metrics.auc_voc(adds) if len(rows) else None,
        **({} if not measured else average_recalls(measured)),
    }


def _figures(rows: Sequence[EstimateRow], false: Sequence[FalsePose]) -> Figures:
    found = [r for r in rows if r.T_cam_obj is not None]
    frames = {(r.scene, r.image): r.seconds for r in rows}
    return {
        **_pose_figures(rows),
        "ece": metrics.expected_calibration_error(
            np.array([r.quality for r in found] + [f.quality for f in false]),
            np.array([r.error.right for r in found] + [False] * len(false), dtype=bool),
        ),
        "seconds_per_frame_p50": float(np.median(list(frames.values()))) if frames else None,
    }
