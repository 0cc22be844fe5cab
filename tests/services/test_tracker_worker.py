"""What the tracker worker publishes: no old pose as TRACKING, no invalid pose, nothing of retired
instances."""

import time
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from huepose.geometry import se3
from huepose.judge.borders import Contours
from huepose.tracking import Tracker, subject
from huepose.tracking.types import Applied
from huepose_protos.messages import CorrectionMessage, FrameHeader, ObjectEntry
from huepose_services import first_frame, models
from huepose_services.doubts import TOO_OLD
from huepose_services.following import Change
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.tied import SUPERVISOR
from huepose_services.tracker import make, tracker_of
from tests.services.tracker_work import (
    AHEAD,
    CENTRE,
    CORRECTION,
    MS,
    BusStandIn,
    Loser,
    frame_of_age,
    worker,
)

HAND = {"parent": "tool0", "translation": [0.0, 0.1, 0.0], "quaternion": [0.0, 0.0, 0.0, 1.0]}


def test_an_added_object_is_prepared_while_it_is_loaded(tea_box, monkeypatch):
    added, listed = replace(tea_box), []
    monkeypatch.setattr(subject, "window_table", listed.append)
    monkeypatch.setattr(models, "load", lambda config: {})
    monkeypatch.setattr(models, "load_one", lambda config, name: added)
    bus = BusStandIn()
    bus.session.declare_queryable = lambda *_: SimpleNamespace(handler=())
    work = make(bus, Config())
    assert work._objects._load("tea_box") is added
    assert listed == [added]
    assert "lines" in vars(Contours.of(added))


@pytest.mark.parametrize(
    ("camera", "odometry", "measured"),
    [
        ({}, True, True),
        ({"mount": HAND}, True, False),
        ({"mount": HAND, "moving": True}, True, True),
        ({"mount": HAND, "tf": {"parent": "base_link", "child": "tool0"}}, True, True),
        ({}, False, False),
    ],
)
def test_the_motion_of_a_fixed_camera_is_not_measured(camera, odometry, measured):
    config = msgspec.convert({"camera": camera, "tracker": {"odometry": odometry}}, Config)
    assert tracker_of(config, {}).config.odometry == measured


def test_hypotheses_are_published_while_somebody_subscribes():
    work, bus, _ = worker()
    work._tracker.instances = (("mug", 0),)
    bus.arriving[FrameHeader] = [frame_of_age(1, 0.0), frame_of_age(2, 0.0)]
    work.step()
    assert bus.aside == {}
    bus.heard.add(bus.keys.hypotheses)
    work.step()
    said = bus.aside[bus.keys.hypotheses]
    assert said.frame_id == 2
    (mug,) = said.objects
    assert [(h.share, h.source) for h in mug.hypotheses] == [
        (pytest.approx(0.75), "flow"),
        (pytest.approx(0.25), "turn"),
    ]
    assert mug.hypotheses[1].quaternion == pytest.approx((0.0, 0.0, np.sin(0.5), np.cos(0.5)))


@pytest.mark.parametrize(("age_ms", "state"), [(0.0, "TRACKING"), (400.0, "SUSPECT")])
def test_an_old_pose_is_never_tracking(age_ms, state):
    work, bus, _ = worker()
    bus.arriving[FrameHeader] = [frame_of_age(1, 0.0), frame_of_age(2, age_ms)]
    work.step()
    work.step()
    assert [p.state for p in bus.said] == ["TRACKING", state]
    assert [p.reason for p in bus.said] == ["", "" if state == "TRACKING" else TOO_OLD]
    assert bus.health.counters.get("poses_too_old", 0) == (state == "SUSPECT")


def test_a_pose_comes_with_the_centre_of_its_object():
    work, bus, _ = worker()
    bus.arriving[FrameHeader] = [frame_of_age(1, 0.0)]
    work.step()
    assert [p.centre for p in bus.said] == [tuple(CENTRE)]


def test_the_first_frame_of_a_recording_does_not_get_old():
    work, bus, _ = worker(once=True)
    bus.arriving[FrameHeader] = [frame_of_age(1, 2000.0), frame_of_age(2, 400.0)]
    work.step()
    work.step()
    assert [p.state for p in bus.said] == ["TRACKING", "SUSPECT"]


@pytest.mark.parametrize(
    ("scale", "y"), [((1, 1, 1), np.nan), ((1, 1, 1), np.inf), ((1, 1, -1), 0.0), ((1.01, 1, 1), 0.0)]
)
def test_an_invalid_pose_is_not_published(scale, y, capfd):
    T_cam_obj = se3.make(np.diag(scale), np.array([0.0, y, 0.5]))
    work, bus, _ = worker(T_cam_obj)
    bus.arriving[FrameHeader] = [frame_of_age(1, 0.0)]
    work.step()
    assert bus.said == []
    assert bus.health.counters["poses_refused"] == 1
    assert "pose of mug/0" in capfd.readouterr().err


def test_a_correction_of_a_retired_instance_is_not_applied():
    work, bus, objects = worker(np.eye(4))
    name, epoch = CORRECTION.object, CORRECTION.camera_epoch
    entry = ObjectEntry(object=name, max_instances=1, searching=1, resets=1, retired=(epoch, 4))
    objects.next = [Change(entry)]
    bus.arriving[CorrectionMessage] = [msgspec.structs.replace(CORRECTION, instance=i) for i in (3, 4)]
    work.step()
    assert work._tracker.corrections == [4]
    assert bus.health.counters["corrections_of_retired"] == 1


@pytest.mark.parametrize("before", [0, 1, 2])
def test_an_instance_that_is_found_in_the_newest_frame_is_published_before_the_next(before):
    """Also if it was LOST in that frame: perception would be asked about the frame again and again."""
    work, bus, _ = worker()
    tracked = work._tracker.step
    lost = Loser(AHEAD)
    work._tracker.step = (lambda frame: []) if before == 0 else lost.step if before == 1 else tracked
    header, payload = frame_of_age(1, 0.0)
    bus.arriving[FrameHeader] = [(header, payload)]
    work.step()
    assert [p.state for p in bus.said] == [[], ["LOST"], ["TRACKING"]][before]
    bus.said.clear()
    found = tracked(work._pixels)
    work._tracker.poses = lambda: found
    message = msgspec.structs.replace(CORRECTION, object="mug", instance=0)
    for applied in (Applied.APPLIED, Applied.REPEATED, Applied.APPLIED):
        work._tracker.answer = applied
        bus.arriving[CorrectionMessage] = [message]
        work.step()
    assert [p.state for p in bus.said] == ([] if before == 2 else ["TRACKING"])


def test_a_correction_of_an_object_that_is_still_being_loaded_is_no_error(capfd):
    work, bus, _ = worker()
    work._tracker = Tracker({})
    bus.arriving[CorrectionMessage] = [CORRECTION]
    work.step()
    assert bus.health.counters == {"corrections_of_unknown": 1}
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("removed", [True, False])
def test_nothing_is_kept_of_retired_instances(removed, monkeypatch):
    work, bus, objects = worker()
    monkeypatch.setattr(work._tracker, "remove_object", lambda name: None, raising=False)
    bus.arriving[FrameHeader] = [frame_of_age(1, 0.0)]
    work.step()
    assert list(work._told._now) == ["mug/0"]
    work._told._logged["mug/0"] = ("TRACKING", 0.0)
    work._told.note("mugs/0", "TRACKING")
    objects.next = [Change(ObjectEntry(object="mug", max_instances=1, searching=1), removed=removed)]
    work.step()
    assert bus.forgotten == [bus.keys.pose("mug", 0).removesuffix("/0")]
    assert (list(work._told._now), list(work._told._logged)) == (["mugs/0"], [])


def test_while_perception_answers_too_late_a_warning_says_what_to_do(capfd):
    work, bus, _ = worker()
    header, payload = frame_of_age(1, 0.0)
    bus.arriving[FrameHeader] = [(header, payload)]
    work.step()
    late = msgspec.structs.replace(
        CORRECTION, object="mug", instance=0, verdict="correct", capture_ns=header.capture_ns - 8_000 * MS
    )
    work._tracker.answer = Applied.REFUSED_OLD
    bus.arriving[CorrectionMessage] = [late, late]
    work.step()
    (warning,) = bus.health.message().warnings
    assert "answers 8.0 s after" in warning
    assert "kept for 4.0 s" in warning
    # It should keep 1.3 times 8 s: 6.4 s more than 4 s, two frames for each 4/15 s.
    assert "tracker.older_frames to 72" in warning
    said = "found another pose of mug/0 in an image 8.0 s old; it is not applied: perception answers"
    assert capfd.readouterr().err.count(said) == 1
    work._tracker.answer = Applied.CATCHING_UP
    bus.arriving[CorrectionMessage] = [msgspec.structs.replace(late, seq=late.seq + 1)]
    work.step()
    assert bus.health.message().warnings == []
    work._tracker.answer, work._tracker.reach_s = Applied.REFUSED_OLD, None
    bus.arriving[CorrectionMessage] = [msgspec.structs.replace(late, seq=late.seq + 2)]
    work.step()
    assert bus.health.message().warnings == [], "a tracker that has just started keeps few frames"


@pytest.mark.parametrize(
    ("answer", "verdict", "reach_s", "age_ms", "said"),
    [
        (
            Applied.REFUSED_EPOCH,
            "acquire",
            4.0,
            300,
            "found mug/0 in an image 0.3 s old; it is not applied: the camera was opened again since",
        ),
        (
            Applied.REFUSED_EPOCH,
            "acquire",
            4.0,
            -1300,
            "found mug/0 in an older image; it is not applied: the camera was opened again since",
        ),
        (
            Applied.REFUSED_OLD,
            "agree",
            4.0,
            300,
            "mug/0 is where it is tracked in an image 0.3 s old; it is not applied: it is no longer "
            "tracked. Nothing needs to be done",
        ),
        (
            # Of an instance of the previous tracker process.
            Applied.REFUSED_OLD,
            "correct",
            4.0,
            300,
            "found another pose of mug/0 in an image 0.3 s old; it is not applied: it is no longer "
            "tracked. Nothing needs to be done",
        ),
        (
            Applied.REFUSED_OLD,
            "correct",
            None,
            300,
            "that was before the tracker started. Nothing needs to be done",
        ),
    ],
)
def test_the_log_says_what_was_refused_and_why(capfd, answer, verdict, reach_s, age_ms, said):
    """And only corrections that come too late make perception slow."""
    work, bus, _ = worker()
    header, payload = frame_of_age(1, 0.0)
    bus.arriving[FrameHeader] = [(header, payload)]
    work.step()
    work._tracker.answer, work._tracker.reach_s = answer, reach_s
    bus.arriving[CorrectionMessage] = [
        msgspec.structs.replace(
            CORRECTION, object="mug", instance=0, verdict=verdict, capture_ns=header.capture_ns - age_ms * MS
        )
    ]
    work.step()
    assert said in capfd.readouterr().err
    assert bus.health.message().warnings == []


def test_without_a_camera_the_tracker_warns_until_a_frame_comes(capfd, monkeypatch):
    at = [now_ns()]
    monkeypatch.setattr(first_frame, "now_ns", lambda: at[0])
    work, bus, _ = worker()
    warnings = []
    for _ in range(8):
        work.step()
        warnings.append(bus.health.message().warnings)
        at[0] += SECOND
    assert warnings[:6] == [[]] * 6, "a camera that is plugged in takes a moment"
    assert "`huepose run camera`" in warnings[7][0]
    assert capfd.readouterr().err.count("no frame has come yet") == 1
    bus.arriving[FrameHeader] = [frame_of_age(1, 0.0)]
    work.step()
    assert bus.health.message().warnings == []


def test_under_a_supervisor_the_tracker_does_not_warn_of_a_missing_camera(monkeypatch):
    monkeypatch.setenv(SUPERVISOR, "1")
    at = [now_ns()]
    monkeypatch.setattr(first_frame, "now_ns", lambda: at[0])
    work, bus, _ = worker()
    at[0] += 60 * SECOND
    work.step()
    assert bus.health.message().warnings == []


def test_a_change_of_state_is_in_the_log_once(capfd):
    work, bus, _ = worker()
    until = time.monotonic() + 0.4
    number = 0
    while time.monotonic() < until:
        number += 1
        bus.arriving[FrameHeader] = [frame_of_age(number, 0.0)]
        work.step()
        time.sleep(0.01)
    assert capfd.readouterr().err.count("mug/0 TRACKING") == 1


def test_no_correction_of_the_far_future_is_taken():
    """Its number would be above those of all later corrections."""
    work, bus, _ = worker(np.eye(4))
    now = now_ns()
    bus.arriving[CorrectionMessage] = [
        msgspec.structs.replace(CORRECTION, seq=2**63 - 1, instance=1),
        msgspec.structs.replace(CORRECTION, seq=now, instance=2),
    ]
    work.step()
    assert work._tracker.corrections == [2]
    assert bus.health.counters["wire_errors"] == 1


def test_without_a_new_frame_no_pose_stays_tracking():
    work, bus, _ = worker()
    assert work.due_ns() is None
    bus.arriving[FrameHeader] = [frame_of_age(1, 0.0)]
    work.step()
    due_ns = work.due_ns()
    assert due_ns is not None
    assert 0 < due_ns - now_ns() <= 300 * MS
    work.step()
    assert [p.state for p in bus.said] == ["TRACKING"], "not before it is due"
    time.sleep((due_ns - now_ns()) * 1e-9 + 0.001)
    work.step()
    work.step()
    assert [p.state for p in bus.said] == ["TRACKING", "SUSPECT"]
    assert bus.said[1].frame_id == bus.said[0].frame_id
    assert SECOND // 2 < work.due_ns() - now_ns() <= SECOND
    bus.arriving[FrameHeader] = [frame_of_age(2, 0.0)]
    work.step()
    assert bus.said[-1].state == "TRACKING"


@pytest.mark.parametrize(
    ("once", "why"),
    [
        (False, "No new frame came."),
        (True, "No new frame came: the recording has ended, or it falls behind."),
    ],
)
def test_after_the_camera_stopped_suspect_poses_are_published_once_a_second(once, why):
    at = [now_ns()]
    work, bus, objects = worker(once=once, clock=lambda: at[0])
    # The repeated first frame never gets old.
    bus.arriving[FrameHeader] = [frame_of_age(0, 0.0)] * once + [frame_of_age(1, 0.0)]
    work.step()
    if once:
        work.step()
        bus.said.pop(0)
    for _ in range(50):  # five seconds
        at[0] += SECOND // 10
        work.step()
    said = bus.said[1:]
    assert [p.publish_ns - said[0].publish_ns for p in said] == [k * SECOND for k in range(5)]
    assert {(p.state, p.frame_id, p.reason) for p in said} == {("SUSPECT", 1, why)}
    assert bus.health.counters["poses_too_old"] == 1
    objects.next = [Change(ObjectEntry(object="mug", max_instances=1, searching=1), removed=True)]
    work._tracker.remove_object = lambda name: None
    at[0] += 2 * SECOND
    work.step()
    assert bus.said[1:] == said, "nothing is published of a removed object"
    assert work.due_ns() is None


@pytest.mark.parametrize("raises", [True, False])
def test_poses_are_withdrawn_if_the_next_frames_are_not_tracked(raises, monkeypatch):
    at = [now_ns()]
    work, bus, _ = worker(clock=lambda: at[0])
    bus.arriving[FrameHeader] = [frame_of_age(5, 0.0), frame_of_age(2, 200.0)]
    work.step()
    last_poses = work._tracker.step(SimpleNamespace(epoch=1, frame_id=5, stamp_ns=at[0]))

    def step(frame):
        if raises:
            raise ValueError("broken")
        return []  # an older one

    monkeypatch.setattr(work._tracker, "step", step)
    monkeypatch.setattr(work._tracker, "poses", lambda: last_poses)
    if raises:
        with pytest.raises(ValueError, match="broken"):
            work.step()
    else:
        work.step()
    assert bus.health.counters.get("frames_older", 0) == (not raises)
    at[0] += SECOND
    work.step()
    assert [(p.state, p.frame_id) for p in bus.said] == [("TRACKING", 5), ("SUSPECT", 5)]


def test_the_repeated_first_frame_of_a_recording_stays_tracking():
    work, bus, _ = worker(once=True)
    bus.arriving[FrameHeader] = [frame_of_age(1, 2000.0)]
    work.step()
    assert bus.said[0].state == "TRACKING"
    assert work.due_ns() is None


def test_a_pose_of_the_future_is_not_tracking():
    work, bus, _ = worker()
    bus.arriving[FrameHeader] = [frame_of_age(1, -400.0)]
    work.step()
    assert [p.state for p in bus.said] == ["SUSPECT"]
