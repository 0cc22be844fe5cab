"""What the tracker worker publishes: no invalid pose, nothing of retired instances."""

import time
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from huepose.geometry import se3
from huepose.judge.borders import Contours
from huepose.tracking import Tracker, subject
from huepose.tracking.types import Applied
from huepose_protos.messages import CorrectionMessage, FrameHeader, ObjectEntry
from huepose_services import models
from huepose_services.following import Change
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config
from huepose_services.tracker import make, tracker_of
from tests.services.conftest import until
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


def test_a_pose_comes_with_the_centre_of_its_object():
    work, bus, _ = worker()
    bus.arriving[FrameHeader] = [frame_of_age(1, 0.0)]
    work.step()
    assert [p.centre for p in bus.said] == [tuple(CENTRE)]


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


def test_a_change_of_state_is_in_the_log_once(capfd):
    work, bus, _ = worker()
    numbers, said = count(1), []

    def step():
        bus.arriving[FrameHeader] = [frame_of_age(next(numbers), 0.0)]
        work.step()
        time.sleep(0.01)
        said.append(capfd.readouterr().err)

    until(lambda: "mug/0 TRACKING" in "".join(said), act=step)
    for _ in range(30):
        step()
    assert "".join(said).count("mug/0 TRACKING") == 1


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
