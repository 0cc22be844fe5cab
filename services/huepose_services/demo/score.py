"""Score of a live run: published poses against ground truth of the same frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from huepose.datasets.types import GONE, VISIBLE
from huepose.evaluation.metrics import RECALL_FRACTION, add, adds, four_figures
from huepose.evaluation.states import Moment, StateReport, combined, report
from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.symmetry import nearest_alike
from huepose.support.words import counted
from huepose_protos.messages import PoseMessage, TruthMessage
from huepose_services.convert import optional_pose_from_wire, pose_of
from huepose_services.runtime.clock import SECOND

_MIN_RECALL = 90.0
_CONFIRMED_WITHIN_S = 3.0


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What errors of an object are measured with: points (N, 3), its diameter, and its equivalent rotations
    (E, 4, 4)."""

    points_obj: Float32
    diameter_m: float
    equivalents: Float64
    tree: cKDTree = field(repr=False)

    @staticmethod
    def of(
        points_obj: Float32, diameter_m: float, equivalents: Float64 | None = None, at_most: int = 2000
    ) -> Yardstick:
        """From every k-th point, at most `at_most`. equivalents: by default only the identity."""
        points = points_obj[:: max(1, -(-len(points_obj) // at_most))]
        alike = np.eye(4)[None] if equivalents is None else np.asarray(equivalents, np.float64)
        return Yardstick(points, diameter_m, alike, cKDTree(points))

    def add(self, T_cam_obj: Float64, truth: Float64) -> float:
        """ADD of a pose (4, 4), metres, to the nearest pose that is equivalent to the true one."""
        return add(self.points_obj, T_cam_obj, nearest_alike(truth, self.equivalents, T_cam_obj))


@dataclass(frozen=True, eq=False)
class _Label:
    stamp_ns: int
    T_cam_obj: Float64
    visib_fract: float | None


@dataclass(frozen=True)
class Latest:
    """The present state of an object, for the table. error_m: ADD of its last pose, None if that is
    unknown."""

    state: str = "SEARCHING"
    error_m: float | None = None
    rate_hz: float = 0.0
    age_ms: float | None = None


class Score:
    """Collects messages of one instance of each object, and scores them on request."""

    def __init__(self, yardsticks: Mapping[str, Yardstick]) -> None:
        self._yardsticks = dict(yardsticks)
        self._labels: dict[str, dict[int, _Label]] = {name: {} for name in yardsticks}
        self._poses: dict[str, dict[int, PoseMessage]] = {name: {} for name in yardsticks}
        self.first_ns: int | None = None
        self.last_ns = 0
        self._begin_ns = 0

    def begin(self, now_ns: int) -> None:
        """Ignore frames captured before now: not all workers were running then."""
        self._begin_ns = now_ns

    def add_truth(self, truth: TruthMessage) -> None:
        """Keep the true poses of a frame."""
        if truth.capture_ns < self._begin_ns:
            return
        self.first_ns = truth.capture_ns if self.first_ns is None else self.first_ns
        self.last_ns = max(self.last_ns, truth.capture_ns)
        for item in truth.objects:
            T_cam_obj = optional_pose_from_wire(item.translation, item.quaternion)
            if item.object in self._labels and T_cam_obj is not None:
                label = _Label(truth.capture_ns, T_cam_obj, item.visib_fract)
                self._labels[item.object][truth.frame_id] = label

    def add_pose(self, pose: PoseMessage) -> None:
        """Keep a published pose; of several tracks of an object, the pose of the highest quality counts."""
        if pose.capture_ns < self._begin_ns:
            return
        mine = self._poses.get(pose.object)
        if mine is not None and (pose.frame_id not in mine or mine[pose.frame_id].quality < pose.quality):
            mine[pose.frame_id] = pose

    def latest(self) -> dict[str, Latest]:
        """The rows of the table, by object."""
        return {name: self._latest_of(name) for name in self._yardsticks}

    def _latest_of(self, name: str) -> Latest:
        poses = list(self._poses[name].values())[-45:]
        if not poses:
            return Latest()
        last = poses[-1]
        recent = [p for p in poses if last.capture_ns - p.capture_ns < SECOND]
        return Latest(last.state, self._error(name, last), float(len(recent)), last.age_ms)

    def _error(self, name: str, pose: PoseMessage) -> float | None:
        label, T_cam_obj = self._labels[name].get(pose.frame_id), pose_of(pose)
        if label is None or T_cam_obj is None:
            return None
        return self._yardsticks[name].add(T_cam_obj, label.T_cam_obj)

    def summary(self, until_ns: int) -> dict[str, Any]:
        """The figures of the demo over the frames captured until `until_ns`, named as in the evaluation.

        Recall and AUC count frames from an object's confirmation on, or from 3 s after it became visible if
        it is not confirmed by then; a frame without a pose counts as wrong. Percent, seconds, milliseconds;
        an unknown figure is null. `per_object` has the same figures for each object."""
        reports, errors = {}, {}
        for name in self._yardsticks:
            reports[name], errors[name] = self._judge(name, until_ns)
        total = combined(list(reports.values()))
        rows = np.concatenate(list(errors.values())) if errors else np.zeros((0, 3))
        poses = [p for mine in self._poses.values() for p in mine.values()]
        ages = [p.age_ms for p in poses if p.capture_ns <= until_ns]
        acquired = all(r.acquired_after_s is not None or not r.visible_frames for r in reports.values())
        figures = four_figures(rows[:, 0], rows[:, 1], rows[:, 2])
        return {
            "recall_add": figures["recall_add"],
            "recall_adds": figures["recall_adds"],
            "auc_add": figures["auc_add"],
            "acquired_after_s": total.acquired_after_s if acquired else None,
            "confirmed_after_s": None if total.never_confirmed else total.confirmed_after_s,
            "false_tracking_frames": total.false_tracking_frames,
            "coverage_tracking": total.coverage_tracking,
            "latency_ms_p50": float(np.percentile(ages, 50)) if ages else None,
            "latency_ms_p99": float(np.percentile(ages, 99)) if ages else None,
            "frames": max((r.frames for r in reports.values()), default=0),
            "objects": len(self._yardsticks),
            "per_object": {
                name: _one(reports[name], errors[name]) | {"doubts": self._doubts(name, until_ns)}
                for name in self._yardsticks
            },
        }

    def _doubts(self, name: str, until_ns: int) -> dict[str, float]:
        """The reasons why poses were not TRACKING, most frequent first, each with its share of the poses in
        percent."""
        poses = [pose for pose in self._poses[name].values() if pose.capture_ns <= until_ns]
        reasons = Counter(pose.reason for pose in poses if pose.state != "TRACKING" and pose.reason)
        return {reason: 100.0 * count / len(poses) for reason, count in reasons.most_common()}

    def _judge(self, name: str, until_ns: int) -> tuple[StateReport, Float64]:
        """The state report of an object, and rows (ADD, ADD-S, diameter) of the frames that count."""
        yardstick, moments, rows = self._yardsticks[name], [], []
        appeared_ns: int | None = None
        for frame_id, label in sorted(self._labels[name].items(), key=lambda item: item[1].stamp_ns):
            if label.stamp_ns > until_ns:
                continue
            pose = self._poses[name].get(frame_id)
            T_cam_obj = None if pose is None else pose_of(pose)
            error = error_s = np.inf
            if T_cam_obj is not None:
                error = yardstick.add(T_cam_obj, label.T_cam_obj)
                error_s = adds(yardstick.points_obj, T_cam_obj, label.T_cam_obj, yardstick.tree)
            visible = label.visib_fract is None or label.visib_fract >= VISIBLE
            gone = label.visib_fract is not None and label.visib_fract < GONE
            right = error < RECALL_FRACTION * yardstick.diameter_m
            state = None if pose is None else pose.state
            moments.append(Moment(label.stamp_ns, visible, gone, state, bool(right)))
            if visible and appeared_ns is None:
                appeared_ns = label.stamp_ns
            if appeared_ns is not None and not gone:
                rows.append((label.stamp_ns - appeared_ns, error, error_s, yardstick.diameter_m))
        states, table = report(moments), np.array(rows, dtype=np.float64).reshape(-1, 4)
        confirmed_s = _CONFIRMED_WITHIN_S if states.confirmed_after_s is None else states.confirmed_after_s
        counted = table[:, 0] >= 1e9 * min(confirmed_s, _CONFIRMED_WITHIN_S) - 1.0
        return states, table[counted, 1:]


def _one(states: StateReport, errors: Float64) -> dict[str, Any]:
    figures = four_figures(errors[:, 0], errors[:, 1], errors[:, 2])
    tracked = errors[np.isfinite(errors[:, 0]), 0]
    return {
        **{name: figures[name] for name in ("recall_add", "recall_adds", "auc_add")},
        "add_mm_p50": float(np.median(tracked) * 1000.0) if len(tracked) else None,
        "acquired_after_s": states.acquired_after_s,
        "confirmed_after_s": states.confirmed_after_s,
        "false_tracking_frames": states.false_tracking_frames,
        "coverage_tracking": states.coverage_tracking,
    }


def shortcomings(summary: Mapping[str, Any]) -> list[str]:
    """Which expectations the run did not meet, the most dangerous first: no false TRACKING, every object
    acquired, ADD recall of 90 % or more."""
    out = []
    false = {name: of["false_tracking_frames"] for name, of in summary["per_object"].items()}
    if any(false.values()):
        where = [f"{name} in {counted(frames, 'frame')}" for name, frames in false.items() if frames]
        out.append(f"false TRACKING, on which a robot would have acted: {', '.join(where)}")
    if summary["acquired_after_s"] is None:
        never = [n for n, of in summary["per_object"].items() if of["acquired_after_s"] is None]
        out.append(f"{', '.join(never)} had no right pose")
    if (summary["recall_add"] or 0.0) < _MIN_RECALL:
        out.append(f"ADD recall is {summary['recall_add'] or 0.0:.1f} %, under {_MIN_RECALL:.0f}")
    return out
