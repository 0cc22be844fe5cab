"""The rows of a tracking evaluation, and their summary: a mean for each sequence, then over sequences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from huepose.evaluation.instances import Place, PublishedPose, match
from huepose.evaluation.measured import unit_of
from huepose.evaluation.metrics import ROFT_FIGURES, roft_figures
from huepose.evaluation.states import TIMES, Moment, StateReport, combined, report
from huepose.evaluation.summary import (
    POSE_FIGURES,
    Figures,
    grouped,
    largest,
    mean_figures,
    pose_figures,
    pose_intervals,
)
from huepose.evaluation.targets import PoseError, Targets, object_number
from huepose.geometry.arrays import Float64


@dataclass(frozen=True, eq=False)
class TrackRow:
    """One instance of an object in one frame, and the pose that was published for it.

    ordinal: number of the instance among those of its object, from 0; error, gt_instance: None if the frame
    has no label of it; seconds: the frame's wall time with all objects, None if unknown; T_truth: the
    labelled pose (4, 4); velocity (6,): as published."""

    sequence: str
    frame: int
    stamp_ns: int
    object: int | str
    ordinal: int
    gt_instance: int | None
    track: int | None
    T_cam_obj: Float64 | None
    error: PoseError | None
    diameter_m: float
    visible: bool
    gone: bool
    visib_fract: float | None
    state: str | None
    quality: float
    seconds: float | None
    seed: int
    T_truth: Float64 | None = None
    velocity: Float64 | None = None

    @property
    def scored(self) -> bool:
        """The row counts in recall and AUC: labelled and not gone."""
        return self.error is not None and not self.gone

    @property
    def moment(self) -> Moment:
        """The row as input for the figures of the states. Without a label, a pose counts as right until the
        object has been gone for long."""
        right = self.error is None or self.error.right
        return Moment(self.stamp_ns, self.visible, self.gone, self.state, right)

    def as_json(self) -> dict[str, Any]:
        """The row in its file form."""
        record = {name: value for name, value in vars(self).items() if name != "error"}
        return record | {key: getattr(self.error, key, None) for key in ("add_m", "adds_m", "right")}


def rows_of_frame(
    sequence: str,
    image: int,
    stamp_ns: int,
    here: Sequence[Place],
    published: Sequence[PublishedPose],
    targets: Targets,
    seconds: float | None = None,
    seed: int = 0,
) -> tuple[list[TrackRow], int]:
    """The published poses of a frame against its labels: a row for each instance, and the number of phantoms
    that are TRACKING."""
    chosen, phantoms = match(here, published)
    rows = []
    for place, pose in zip(here, chosen, strict=True):
        truth, model = place.truth, place.model
        T_cam_obj = None if pose is None else pose.T_cam_obj
        error = None
        if truth is not None and truth.T_cam_obj is not None:
            error = targets.error(model, T_cam_obj, truth.T_cam_obj)
        row = TrackRow(
            sequence=sequence,
            frame=image,
            stamp_ns=stamp_ns,
            object=object_number(model),
            ordinal=place.ordinal,
            gt_instance=None if truth is None else truth.instance,
            track=None if pose is None else pose.track,
            T_cam_obj=T_cam_obj,
            error=error,
            diameter_m=model.diameter_m,
            visible=truth is not None and truth.visible,
            gone=truth is None or truth.gone,
            visib_fract=None if truth is None else truth.visib_fract,
            state=None if pose is None else pose.state,
            quality=0.0 if pose is None else pose.quality,
            seconds=seconds,
            seed=seed,
            T_truth=None if truth is None else truth.T_cam_obj,
            velocity=None if pose is None else pose.velocity,
        )
        rows.append(row)
    return rows, sum(pose.state == "TRACKING" for pose in phantoms)


@dataclass(frozen=True, eq=False)
class TrackResult:
    """All rows. phantoms: number of poses of no instance that are TRACKING, by (sequence, seed); settings: of
    the run; measured: further figures of the whole run."""

    rows: Sequence[TrackRow]
    phantoms: Mapping[tuple[str, int], int]
    settings: Mapping[str, Any]
    measured: Mapping[str, Any] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Figures in percent, times in seconds: means over seeds, but for the times of TIMES the largest."""
        seeds = list(grouped(self.rows, lambda r: r.seed))
        blocks = {seed: self._of_seed(seed) for seed in seeds}
        flat = [{k: v for k, v in b.items() if not isinstance(v, dict)} for b in blocks.values()]
        names = list(blocks[seeds[0]]["sequences"])
        return {
            **self.settings,
            "seed": seeds[0] if len(seeds) == 1 else seeds,
            **_counts_as_whole(mean_figures(flat)),
            **{key: largest(block[key] for block in flat) for key in TIMES},
            **self.measured,
            "frame_weighted": _counts_as_whole(
                mean_figures(block["frame_weighted"] for block in blocks.values())
            ),
            "sequences": {
                name: _counts_as_whole(mean_figures(block["sequences"][name] for block in blocks.values()))
                for name in names
            },
            **_intervals(self.rows),
            "by_seed": {seed: {k: v for k, v in b.items() if k != "sequences"} for seed, b in blocks.items()},
        }

    def _of_seed(self, seed: int) -> dict[str, Any]:
        rows = [row for row in self.rows if row.seed == seed]
        sequences, reports = {}, []
        for name, own in grouped(rows, lambda r: r.sequence).items():
            instances = list(grouped(own, lambda r: (r.object, r.ordinal)).values())
            states = [report([row.moment for row in instance]) for instance in instances]
            reports += states
            phantoms = self.phantoms.get((name, seed), 0)
            sequences[name] = {
                **_pose_figures(own),
                **mean_figures(_roft_figures(instance) for instance in instances),
                **_state_figures(combined(states), phantoms),
                **_fps(own),
            }
        total = _state_figures(combined(reports), sum(n for (_, s), n in self.phantoms.items() if s == seed))
        figures = mean_figures({key: block[key] for key in _MEANS} for block in sequences.values())
        return {
            **figures,
            **{key: value for key, value in total.items() if key not in _MEANS},
            "instances": float(sum(row.scored for row in rows)),
            **_fps(rows),
            "frame_weighted": _pose_figures(rows),
            "sequences": sequences,
        }

    def as_json(self) -> dict[str, Any]:
        """The result file."""
        return {
            "summary": self.summary(),
            "rows": [row.as_json() for row in self.rows],
            "phantoms": [
                {"sequence": sequence, "seed": seed, "frames": frames}
                for (sequence, seed), frames in self.phantoms.items()
            ],
        }


_FAULTS = ("lost_frames", "never_confirmed")
_WHOLE = (
    *("instances", "false_tracking_frames", "declared_suspect_after_frames", "declared_lost_after_frames"),
    *_FAULTS,
)
_MEANS = (*POSE_FIGURES, "coverage_tracking", *ROFT_FIGURES)


def _counts_as_whole(figures: Figures) -> Figures:
    """Counts without a fraction become integers; means over seeds may have a fraction."""
    return {
        key: int(value) if value is not None and key in _WHOLE and value == int(value) else value
        for key, value in figures.items()
    }


def _scored(rows: Sequence[TrackRow]) -> list[dict[str, Any]]:
    return [row.as_json() for row in rows if row.scored]


def _pose_figures(rows: Sequence[TrackRow]) -> Figures:
    scored = _scored(rows)
    return {**pose_figures(scored), "instances": float(len(scored))}


def _intervals(rows: Sequence[TrackRow]) -> dict[str, Any]:
    """`interval95`: of the figures of all frames; `interval95_over`: the unit of the bootstrap, in words."""
    units = unit_of([row.as_json() for row in rows])
    of_scored = [unit for row, unit in zip(rows, units.of, strict=True) if row.scored]
    return {"interval95": pose_intervals(_scored(rows), of_scored), "interval95_over": units.many}


def _roft_figures(rows: Sequence[TrackRow]) -> Figures:
    """ROFT's figures of one instance, in order of time. Frames that do not count have no truth: what the
    object does in them is no velocity of the frames beside them."""
    return roft_figures(
        [row.T_cam_obj for row in rows],
        [row.T_truth if row.scored else None for row in rows],
        [row.stamp_ns for row in rows],
        [row.velocity for row in rows],
    )


def _state_figures(states: StateReport, phantoms: int) -> Figures:
    false = states.false_tracking_frames + phantoms
    return {
        **{name: float(getattr(states, name)) for name in _FAULTS},
        **{name: getattr(states, name) for name in TIMES},
        "coverage_tracking": states.coverage_tracking,
        "false_tracking_frames": float(false),
        "false_tracking_rate": 100.0 * false / states.frames if states.frames else 0.0,
    }


def _fps(rows: Sequence[TrackRow]) -> Figures:
    """Number of frames divided by the sum of their times; None if no frame was timed."""
    seconds = {(row.sequence, row.frame): row.seconds for row in rows if row.seconds is not None}
    total = sum(seconds.values())
    return {"fps": len(seconds) / total if total > 0 else None}
