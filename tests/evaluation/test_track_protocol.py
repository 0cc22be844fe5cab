"""The tracking protocol, with a tracker that moves poses by the true motion, plus a given drift.

With such a tracker the result is known: after a right late pose, all poses are right.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.evaluation.pose_files import PoseTable
from huepose.evaluation.result_files import plain
from huepose.evaluation.sources import EstimatorSource, FileSource, TruthSource
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_protocol import Sources, TrackOptions, evaluate_tracking
from huepose.geometry import se3
from huepose.support.errors import InputError
from huepose.tracking.types import Applied, Correction, TrackedPose, Verdict

from .conftest import MemoryScene, PartlyLabelled, ScriptedEstimator, estimate_of, pose_at, truth


def motion(i: int, turn: float = 0.05) -> np.ndarray:
    return pose_at(-0.15 + 0.01 * i, 0.002 * i, 0.6, turn * i)


def sequence(
    frames: int = 31, name: str = "box_run", ids: tuple[int, ...] = (5,), turn: float = 0.05
) -> MemoryScene:
    labels = {
        i: tuple(
            truth(k, o, se3.compose(se3.make(np.eye(3), [0, 0.1 * k, 0]), motion(i, turn)))
            for k, o in enumerate(ids)
        )
        for i in range(frames)
    }
    return MemoryScene(name, labels)


class IncrementTracker:
    """Moves poses by the motion of the labels plus `drift_m` along x per frame; replays corrections."""

    def __init__(self, scene: MemoryScene, objects: Mapping[str, int], drift_m: float = 0.0) -> None:
        self.scene, self.objects, self.drift_m = scene, objects, drift_m
        self.frames: list[int] = []
        self.poses: dict[tuple[str, int], dict[int, np.ndarray]] = {}
        self.waiting: list[Correction] = []
        self.taken: list[tuple[int | None, Correction]] = []

    def label(self, name: str, frame: int) -> np.ndarray:
        return self.scene.truths(frame)[self.objects[name]].T_cam_obj

    def increment(self, name: str, before: int, after: int) -> np.ndarray:
        slip = se3.make(np.eye(3), [self.drift_m, 0, 0])
        return slip @ self.label(name, after) @ se3.inverse(self.label(name, before))

    def correct(self, correction: Correction) -> Applied:
        self.taken.append((self.frames[-1] if self.frames else None, correction))
        if correction.frame_id not in self.frames:
            self.waiting.append(correction)
            return Applied.CATCHING_UP
        self.apply(correction)
        return Applied.APPLIED

    def apply(self, correction: Correction) -> None:
        poses = self.poses.setdefault((correction.object, correction.instance), {})
        poses[correction.frame_id] = correction.T_cam_obj
        later = [f for f in self.frames if f >= correction.frame_id]
        for before, after in pairwise(later):
            poses[after] = self.increment(correction.object, before, after) @ poses[before]

    def step(self, frame) -> list[TrackedPose]:
        for (name, _), poses in self.poses.items():
            if self.frames and self.frames[-1] in poses:
                poses[frame.frame_id] = (
                    self.increment(name, self.frames[-1], frame.frame_id) @ poses[self.frames[-1]]
                )
        self.frames.append(frame.frame_id)
        for correction in self.waiting:
            self.apply(correction)
        self.waiting.clear()
        return [
            TrackedPose(name, k, 0, frame.frame_id, frame.stamp_ns, State.TRACKING, poses[frame.frame_id],
                        None, 0.9, None, 1)
            for (name, k), poses in self.poses.items()
        ]  # fmt: skip


@pytest.fixture
def run(models):
    """Evaluate on a sequence; returns the result and the tracker."""

    def evaluate(scene, options, sources, drift_m=0.0, objects=None, judge=None):
        built = []

        def tracker_for(known):
            assert set(known) == set(objects or {"box": 0})
            built.append(IncrementTracker(scene, objects or {"box": 0}, drift_m))
            return built[-1]

        sources_for = sources if callable(sources) else lambda scene, seed: sources
        result = evaluate_tracking([scene], Targets(models), tracker_for, sources_for, options, judge=judge)
        return result, built[-1]

    return evaluate


TRUTH = Sources(TruthSource(), TruthSource())


def test_free_starts_once_and_is_right_with_true_increments(run) -> None:
    result, tracker = run(sequence(), TrackOptions(), TRUTH)
    assert len(result.rows) == 31
    summary = result.summary()
    assert (summary["recall_add"], summary["auc_add"]) == (100.0, pytest.approx(100.0))
    assert (summary["coverage_tracking"], summary["confirmed_after_s"]) == (100.0, 0.0)
    ((when, correction),) = tracker.taken
    assert (when, correction.frame_id, correction.verdict, correction.seq) == (None, 0, Verdict.ACQUIRE, 1)


def test_free_drifts_by_exactly_the_drift(run) -> None:
    result, _ = run(sequence(turn=0.0), TrackOptions(), TRUTH, drift_m=0.001)
    assert [r.error.add_m for r in result.rows] == pytest.approx([0.001 * i for i in range(31)], abs=1e-9)
    assert result.summary()["auc_add"] == pytest.approx(100 * (1 - 0.015 / 0.1))


def test_roft_delivers_the_result_of_six_frames_ago_at_every_sixth_frame(run) -> None:
    _, tracker = run(sequence(), TrackOptions("roft"), TRUTH)
    # (newest frame before delivery, corrected frame): the correction is applied before the step of its frame.
    assert [(when, c.frame_id) for when, c in tracker.taken] == [
        (None, 0), (5, 0), (11, 6), (17, 12), (23, 18), (29, 24),
    ]  # fmt: skip
    assert [c.seq for _, c in tracker.taken] == [1, 2, 3, 4, 5, 6]


def test_roft_bounds_the_drift_by_periodic_corrections(run) -> None:
    result, _ = run(sequence(turn=0.0), TrackOptions("roft"), TRUTH, drift_m=0.001)
    # A correction is exact at its frame, six frames old when delivered, eleven before the next one.
    expected = [i if i < 6 else i - (i // 6 - 1) * 6 for i in range(31)]
    assert [r.error.add_m for r in result.rows] == pytest.approx([0.001 * e for e in expected], abs=1e-9)


def test_every_fifth_frame_keeps_its_number_and_timestamp(run) -> None:
    result, tracker = run(sequence(), TrackOptions("roft", every=5), TRUTH)
    assert [r.frame for r in result.rows] == [0, 5, 10, 15, 20, 25, 30]
    assert tracker.frames == [0, 5, 10, 15, 20, 25, 30]
    assert [r.stamp_ns for r in result.rows] == [round(i * 1e9 / 30) for i in range(0, 31, 5)]
    assert [(when, c.frame_id) for when, c in tracker.taken][:3] == [(None, 0), (5, 0), (10, 5)]


def test_the_estimator_gets_perturbed_boxes_of_the_scheduled_frames(run) -> None:
    scene = sequence(14)
    estimator = ScriptedEstimator(
        lambda f, q: estimate_of(q, scene.truths(f.frame_id)[q.instance].T_cam_obj, 0.7)
    )

    def sources(scene, seed):
        source = EstimatorSource(estimator, seed)
        return Sources(source, source)

    _, tracker = run(scene, TrackOptions("roft"), sources)
    # Frame 0 is estimated once, though it is delivered twice. The result of frame 12 would come too late.
    assert [frame for frame, _ in estimator.asked] == [0, 6]
    assert all(query.box is not None and query.prior is None for _, query in estimator.asked)
    assert [c.quality for _, c in tracker.taken] == [0.7] * 3


def test_free_has_no_pose_at_all_if_the_object_is_not_found_at_the_start(run) -> None:
    nothing = ScriptedEstimator(lambda f, q: estimate_of(q, None))
    result, tracker = run(sequence(5), TrackOptions(), Sources(EstimatorSource(nothing, 0)))
    assert tracker.taken == []
    assert len(nothing.asked) == 1
    summary = result.summary()
    assert (summary["recall_add"], summary["auc_adds"], summary["coverage_tracking"]) == (0.0, 0.0, 0.0)
    assert summary["never_confirmed"] == 1
    assert all(row.state is None for row in result.rows)


def test_an_object_that_appears_later_is_initialised_then(run) -> None:
    scene = sequence(6)
    labels = {i: (truth(0, 5, motion(i), 0.0 if i < 3 else 0.8),) for i in range(6)}
    result, tracker = run(MemoryScene("s", labels), TrackOptions(), TRUTH)
    assert [c.frame_id for _, c in tracker.taken] == [3]
    assert len(scene.labels) == len(result.rows)
    assert result.summary()["instances"] == 3  # gone frames are left out of recall and AUC


def test_an_unlabelled_frame_is_tracked_and_has_no_row(models) -> None:
    whole = sequence(31)
    sparse = PartlyLabelled("s", {i: whole.labels[i] if i % 10 == 0 else () for i in whole.image_ids})
    tracker = IncrementTracker(whole, {"box": 0})
    result = evaluate_tracking(
        [sparse], Targets(models), lambda known: tracker, lambda s, seed: TRUTH, TrackOptions()
    )
    assert len(tracker.frames) == 31
    assert [row.frame for row in result.rows] == [0, 10, 20, 30]
    summary = result.summary()
    assert (summary["recall_add"], summary["false_tracking_frames"]) == (100.0, 0)


def test_several_objects_of_one_scene_are_tracked(run) -> None:
    scene = sequence(4, ids=(7, 5))
    result, _ = run(scene, TrackOptions(), TRUTH, objects={"brick": 0, "box": 1})
    assert [(r.frame, r.object, r.gt_instance, r.track) for r in result.rows[:2]] == [
        (0, 5, 1, 0),
        (0, 7, 0, 0),
    ]
    assert result.summary()["recall_add"] == 100.0


def test_a_judge_can_reject_poses_from_a_file(run) -> None:
    scene = sequence(20)
    wrong = pose_at(0.3)
    table = PoseTable({(0, "box"): motion(0), (6, "5"): wrong})
    judged = []

    def judge(pose, tracked):
        judged.append((pose.T_cam_obj[0, 3], None if tracked is None else tracked.frame_id))
        return Verdict.REJECT if pose.T_cam_obj is wrong else Verdict.AGREE

    source = FileSource(table)
    result, tracker = run(scene, TrackOptions("roft"), Sources(source, source), judge=judge)
    assert judged == [(motion(0)[0, 3], 0), (0.3, 6)]
    assert [(c.frame_id, c.verdict) for _, c in tracker.taken] == [(0, Verdict.ACQUIRE), (0, Verdict.AGREE)]
    assert result.summary()["recall_add"] == 100.0
    trusting, _ = run(scene, TrackOptions("roft"), Sources(source, source))
    assert trusting.summary()["recall_add"] == pytest.approx(100 * 12 / 20)  # wrong from frame 12 on


def test_tracking_starts_at_the_first_pose_of_a_file(run) -> None:
    source = FileSource(PoseTable({(3, "box"): motion(3)}))
    result, tracker = run(sequence(5), TrackOptions(), Sources(source))
    assert [c.frame_id for _, c in tracker.taken] == [3]
    assert result.summary()["recall_add"] == pytest.approx(100 * 2 / 5)


def test_a_motion_while_the_object_is_gone_is_no_velocity_of_the_frames_beside_it(run) -> None:
    places = [pose_at(0.0 if i < 15 else 0.1) for i in range(31)]
    labels = {i: (truth(0, 5, T, visib=0.0 if 10 <= i < 20 else 1.0),) for i, T in enumerate(places)}
    result, _ = run(MemoryScene("box_run", labels), TrackOptions("free"), TRUTH)
    figures = result.summary()
    assert figures["instances"] == 21
    assert figures["rmse_cm"] == pytest.approx(0.0, abs=1e-6)
    assert figures["rmse_cm_s"] == pytest.approx(0.0, abs=1e-6)


def test_sequences_have_equal_weight_whatever_their_length(models) -> None:
    scenes = [sequence(30, "long"), sequence(10, "short")]
    by_name = {s.name: s for s in scenes}
    trackers = iter(
        [IncrementTracker(by_name["long"], {"box": 0}), IncrementTracker(by_name["short"], {"box": 0}, 0.1)]
    )
    result = evaluate_tracking(
        scenes,
        Targets(models),
        lambda known: next(trackers),
        lambda scene, seed: TRUTH,
        TrackOptions(),
    )
    summary = result.summary()
    assert summary["sequences"]["short"]["auc_add"] == pytest.approx(10.0)  # only its first frame
    assert summary["auc_add"] == pytest.approx(55.0)
    assert summary["frame_weighted"]["auc_add"] == pytest.approx(100 * 31 / 40)
    assert summary["false_tracking_frames"] == 9
    assert summary["false_tracking_rate"] == pytest.approx(100 * 9 / 40)


def test_the_result_file_has_the_documented_keys(run) -> None:
    result, _ = run(sequence(8), TrackOptions(seeds=(0, 1)), TRUTH)
    record = json.loads(json.dumps(plain(result.as_json()), allow_nan=False))
    assert {
        "recall_add", "recall_adds", "auc_add", "auc_adds", "auc_voc_add", "frame_weighted", "sequences",
        "coverage_tracking", "lost_frames", "false_tracking_frames", "false_tracking_rate",
        "declared_lost_after_frames", "reacquired_after_s", "confirmed_after_s", "fps", "by_seed",
    } <= record["summary"].keys()  # fmt: skip
    assert {
        "sequence", "frame", "object", "gt_instance", "track", "T_cam_obj", "add_m", "adds_m", "visib_fract",
        "state", "quality", "seconds",
    } <= record["rows"][0].keys()  # fmt: skip
    assert len(record["rows"]) == 16
    assert record["summary"]["fps"] > 0
    assert record["summary"]["seed"] == [0, 1]


@pytest.mark.parametrize(
    ("scene", "named"),
    [
        (MemoryScene("empty", {0: ()}), "empty"),
        (MemoryScene("frozen", sequence(3).labels, dict.fromkeys(range(3), 5)), "timestamp"),
    ],
)
def test_the_error_names_a_sequence_that_cannot_be_tracked(run, scene, named) -> None:
    with pytest.raises(InputError, match=named):
        run(scene, TrackOptions(), TRUTH)


def test_two_sequences_with_the_same_name_are_refused(models) -> None:
    with pytest.raises(InputError, match="box_run"):
        evaluate_tracking(
            [sequence(2), sequence(2)], Targets(models), lambda known: None, lambda s, seed: TRUTH,
            TrackOptions(),
        )  # fmt: skip
