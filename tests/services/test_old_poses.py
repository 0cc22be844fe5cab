"""The worker tracker: no pose is TRACKING that is old, of the future, or without a frame."""

import time
from types import SimpleNamespace

import pytest

from huepose_protos.messages import FrameHeader, ObjectEntry
from huepose_services import first_frame
from huepose_services.doubts import TOO_OLD
from huepose_services.following import Change
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.tied import SUPERVISOR
from tests.services.tracker_work import (
    MS,
    frame_of_age,
    worker,
)


@pytest.mark.parametrize(("age_ms", "state"), [(0.0, "TRACKING"), (400.0, "SUSPECT")])
def test_an_old_pose_is_never_tracking(age_ms, state):
    work, bus, _ = worker()
    bus.arriving[FrameHeader] = [frame_of_age(1, 0.0), frame_of_age(2, age_ms)]
    work.step()
    work.step()
    assert [p.state for p in bus.said] == ["TRACKING", state]
    assert [p.reason for p in bus.said] == ["", "" if state == "TRACKING" else TOO_OLD]
    assert bus.health.counters.get("poses_too_old", 0) == (state == "SUSPECT")


def test_the_first_frame_of_a_recording_does_not_get_old():
    work, bus, _ = worker(once=True)
    bus.arriving[FrameHeader] = [frame_of_age(1, 2000.0), frame_of_age(2, 400.0)]
    work.step()
    work.step()
    assert [p.state for p in bus.said] == ["TRACKING", "SUSPECT"]


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
    time.sleep(max(0.0, (due_ns - now_ns()) * 1e-9) + 0.001)
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
