"""The demo's figures on runs with known results."""

import numpy as np
import pytest
from msgspec.structs import replace

from huepose.geometry import se3
from huepose_protos.examples import example
from huepose_protos.messages import PoseMessage, TruthMessage, TruthObject
from huepose_services.convert import pose_to_wire
from huepose_services.demo.score import Score, Yardstick, shortcomings
from huepose_services.demo.table import report

SECOND = 1_000_000_000
POINTS = np.random.default_rng(0).uniform(-0.05, 0.05, (500, 3)).astype(np.float32)
EXAMPLE = example(PoseMessage)


def _true_pose(frame):
    return se3.make(se3.rotation_exp([0.0, 0.01 * frame, 0.0]), np.array([0.001 * frame, 0.0, 0.7]))


def _truth(frame, visib_fract=1.0):
    translation, quaternion = pose_to_wire(_true_pose(frame))
    thing = TruthObject(
        object="thing",
        object_id=None,
        instance=0,
        translation=translation,
        quaternion=quaternion,
        visib_fract=visib_fract,
        box=None,
    )
    return TruthMessage(
        publish_ns=frame * SECOND // 10,
        camera_epoch=1,
        frame_id=frame,
        capture_ns=frame * SECOND // 10,
        scene="s",
        image=frame,
        objects=[thing],
    )


def _pose(frame, state="TRACKING", off_m=0.0, quality=0.9):
    import msgspec

    stamp = frame * SECOND // 10
    changes = {"object": "thing", "frame_id": frame, "capture_ns": stamp, "publish_ns": stamp + 20_000_000}
    if state in ("LOST", "SEARCHING"):
        changes |= dict.fromkeys(
            ("translation", "quaternion", "covariance", "velocity_linear", "velocity_angular")
        )
    else:
        T = _true_pose(frame)
        T[0, 3] += off_m
        changes["translation"], changes["quaternion"] = pose_to_wire(T)
    return msgspec.structs.replace(EXAMPLE, state=state, quality=quality, **changes)


def _score(frames, poses):
    score = Score({"thing": Yardstick.of(POINTS, 0.17)})
    for truth in frames:
        score.add_truth(truth)
    for pose in poses:
        score.add_pose(pose)
    return score


def test_a_perfect_run_has_perfect_figures():
    score = _score([_truth(i) for i in range(50)], [_pose(i) for i in range(50)])
    summary = score.summary(score.last_ns)
    assert summary["recall_add"] == summary["recall_adds"] == 100.0
    assert summary["auc_add"] == pytest.approx(100.0, abs=1e-3)
    assert summary["acquired_after_s"] == summary["confirmed_after_s"] == 0.0
    assert summary["false_tracking_frames"] == 0
    assert summary["coverage_tracking"] == 100.0
    assert summary["latency_ms_p50"] == summary["latency_ms_p99"] == 20.0
    assert (summary["frames"], summary["objects"]) == (50, 1)
    assert shortcomings(summary) == []


def test_an_equivalent_rotation_is_no_error():
    rotation_180 = np.diag([-1.0, -1.0, 1.0, 1.0])
    changes = {}
    changes["translation"], changes["quaternion"] = pose_to_wire(_true_pose(0) @ rotation_180)
    rotated = replace(_pose(0), **changes)
    for equivalents, false in ((None, 1), (np.stack([np.eye(4), rotation_180]), 0)):
        score = Score({"thing": Yardstick.of(POINTS, 0.17, equivalents)})
        score.add_truth(_truth(0))
        score.add_pose(rotated)
        assert score.summary(score.last_ns)["false_tracking_frames"] == false
        assert (score.latest()["thing"].error_m < 1e-6) == (false == 0)


def test_frames_without_a_pose_count_as_wrong_after_the_confirmation_and_acquisition_is_timed():
    states = [_pose(i, "SEARCHING") for i in range(10)]
    states += [_pose(i, "SUSPECT") for i in range(10, 15)] + [_pose(i) for i in range(15, 48)]
    score = _score([_truth(i) for i in range(55)], states)
    summary = score.summary(score.last_ns)
    assert summary["recall_add"] == pytest.approx(100 * 33 / 40)
    assert summary["acquired_after_s"] == 1.0
    assert summary["confirmed_after_s"] == 1.5
    assert shortcomings(summary) == ["ADD recall is 82.5 %, under 90"]


def test_a_wrong_pose_as_tracking_is_counted_and_as_suspect_not():
    poses = [_pose(i, off_m=0.03) for i in range(4)] + [_pose(i, "SUSPECT", 0.03) for i in range(4, 50)]
    score = _score([_truth(i) for i in range(50)], poses)
    summary = score.summary(score.last_ns)
    assert summary["false_tracking_frames"] == 4
    assert summary["recall_add"] == 0.0
    assert summary["auc_add"] == pytest.approx(70.0, abs=0.01)
    assert summary["acquired_after_s"] is None
    assert shortcomings(summary)[:2] == [
        "false TRACKING, on which a robot would have acted: thing in 4 frames",
        "thing had no right pose",
    ]


def test_a_single_false_tracking_frame_is_a_shortcoming():
    poses = [_pose(i, off_m=0.03 if i == 20 else 0.0) for i in range(50)]
    summary = _score([_truth(i) for i in range(50)], poses).summary(5 * SECOND)
    assert summary["recall_add"] == 98.0
    assert shortcomings(summary) == ["false TRACKING, on which a robot would have acted: thing in 1 frame"]


def test_frames_with_an_occluded_object_and_the_last_ones_are_left_out():
    frames = [_truth(i, 0.0 if 20 <= i < 30 else 1.0) for i in range(60)]
    poses = [_pose(i) for i in range(50) if not 20 <= i < 30] + [_pose(i, "LOST") for i in range(20, 30)]
    score = _score(frames, poses)
    summary = score.summary(49 * SECOND // 10)
    assert summary["recall_add"] == 100.0
    assert summary["frames"] == 50


def test_of_two_tracks_of_an_object_the_one_of_higher_quality_counts():
    poses = [p for i in range(9) for p in (_pose(i, quality=0.9), _pose(i, off_m=0.05, quality=0.5))]
    score = _score([_truth(i) for i in range(9)], poses)
    assert score.summary(score.last_ns)["recall_add"] == 100.0


def test_an_object_that_is_not_confirmed_counts_three_seconds_after_it_appeared():
    poses = [_pose(i, "SUSPECT", off_m=0.0 if i >= 40 else 0.05) for i in range(50)]
    score = _score([_truth(i) for i in range(50)], poses)
    assert score.summary(score.last_ns)["recall_add"] == pytest.approx(50.0)


def test_an_object_that_is_never_found_fails_the_demo():
    score = _score([_truth(i) for i in range(9)], [])
    summary = score.summary(score.last_ns)
    assert summary["acquired_after_s"] is None
    assert shortcomings(summary) == ["thing had no right pose", "ADD recall is 0.0 %, under 90"]


def test_the_table_shows_the_last_frame():
    score = _score([_truth(i) for i in range(20)], [_pose(i, off_m=0.002) for i in range(20)])
    latest = score.latest()["thing"]
    assert latest.state == "TRACKING"
    assert latest.error_m == pytest.approx(0.002, abs=1e-6)
    assert latest.rate_hz == 10.0
    assert latest.age_ms == 20.0


def test_the_report_names_every_object_and_says_what_is_unknown():
    score = _score([_truth(i) for i in range(50)], [_pose(i) for i in range(50)])
    worker = {"cpu_percent": 12.0, "memory_mib": 300, "rate_hz": 30.0, "work_ms": []}
    lines = report({"summary": score.summary(score.last_ns), "workers": {"camera": worker}}).splitlines()
    thing = next(line for line in lines if line.startswith("thing"))
    assert thing.split() == ["thing", "0.00", "0.00", "100.0", "0.00", "100.0", "0"]
    assert next(line for line in lines if line.startswith("camera")).split()[-2:] == ["-", "-"]


def test_the_report_says_why_an_object_is_often_not_tracking():
    doubted = [replace(_pose(i, "SUSPECT"), reason="It fits twice.") for i in range(20, 40)]
    poses = [*map(_pose, range(20)), *doubted, *map(_pose, range(40, 50))]
    summary = _score([_truth(i) for i in range(50)], poses).summary(5 * SECOND)
    assert summary["per_object"]["thing"]["doubts"] == {"It fits twice.": 40.0}
    said = 'thing was TRACKING in 60 %; 40 % of its poses say "It fits twice."'
    assert said in report({"summary": summary, "workers": {}})


def test_frames_before_all_workers_were_ready_do_not_count():
    score = Score({"thing": Yardstick.of(POINTS, 0.17)})
    score.begin(20 * SECOND // 10)
    for i in range(50):
        score.add_truth(_truth(i))
        score.add_pose(_pose(i, "SEARCHING" if i < 20 else "TRACKING"))
    summary = score.summary(5 * SECOND)
    assert score.first_ns == 2 * SECOND
    assert summary["frames"] == 30
    assert summary["recall_add"] == 100.0
    assert summary["confirmed_after_s"] == 0.0
