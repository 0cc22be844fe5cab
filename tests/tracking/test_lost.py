"""How lost objects are searched for: also beside another instance, at their last position, and how often."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.tracking import Applied, Tracker, TrackerConfig, Verdict, lost, track
from huepose.tracking.persistence import ENOUGH, Persistence
from tests.tracking.conftest import Shoot, correction

GONE, BACK = 6, 20
TURNED = se3.rotation_exp(np.array([1.9, 0.3, 0.4]))


def _at(x: float) -> np.ndarray:
    return se3.make(TURNED, np.array([x, 0.0, 0.6]))


@pytest.fixture
def searches(monkeypatch) -> Counter[int]:
    """How often each part of the image is searched for a lost object, by any tracker."""
    counted: Counter[int] = Counter()
    plain = lost.likeliest_place

    def spy(*args):
        counted[args[3]] += 1
        return plain(*args)

    monkeypatch.setattr(lost, "likeliest_place", spy)
    return counted


def test_an_instance_is_found_though_another_one_is_in_view(tea_box, shoot: Shoot, searches) -> None:
    tracker, here, there = Tracker({"tea_box": tea_box}), _at(-0.13), _at(0.13)
    for number in range(75):
        both = number < GONE or number >= 60
        frame = shoot([(tea_box.mesh, here), *([(tea_box.mesh, there)] if both else [])], number)
        if number == 0:
            tracker.correct(correction(frame, here))
            tracker.correct(correction(frame, there, instance=1))
        poses = tracker.step(frame)
        if number == 59:
            assert [pose.state for pose in poses] == [State.TRACKING, State.LOST]
            assert sum(searches.values()) < 40  # fewer than the frames in which it was lost: the search rests
    assert [pose.state for pose in poses] == [State.TRACKING] * 2
    assert poses[1].T_cam_obj is not None
    np.testing.assert_allclose(poses[1].T_cam_obj[:3, 3], there[:3, 3], atol=0.004)


def test_the_other_parts_of_the_image_are_searched_though_a_look_alike_is_in_view(
    tea_box, shoot: Shoot, searches
) -> None:
    """Two objects with the same surface: the lost one is found where the other is, and given up there."""
    tracker, here = Tracker({"tea_box": tea_box, "also": replace(tea_box, name="also")}), _at(-0.13)
    for number in range(40):
        frame = shoot([(tea_box.mesh, here), *([(tea_box.mesh, _at(0.13))] if number < GONE else [])], number)
        if number == 0:
            tracker.correct(correction(frame, here))
            tracker.correct(correction(frame, _at(0.13), name="also"))
        poses = tracker.step(frame)
    assert {pose.object: pose.state for pose in poses} == {"also": State.LOST, "tea_box": State.TRACKING}
    assert set(searches) > {0, 1}


@pytest.mark.parametrize(("rate_hz", "frames"), [(90, 44), (30, 15), (6, 3)])
def test_after_some_rounds_a_search_waits_half_a_second_and_then_for_its_turn(
    rate_hz: int, frames: int
) -> None:
    persistence, apart_s = Persistence(), 1.0 / rate_hz
    for _ in range(ENOUGH):
        persistence = persistence.missed(apart_s).reached(5, 5)
    for _ in range(frames):
        assert persistence.resting
        persistence = persistence.missed(apart_s)
    for _ in range(3):  # no time in these frames: others came first
        assert not persistence.resting
        persistence = persistence.missed(apart_s).reached(0, 5, searched=False)
    assert persistence.missed(apart_s).reached(5, 5).resting


@pytest.mark.parametrize("what", ["clock set back", "corrected", "new epoch"])
def test_a_lost_object_is_found_when_it_is_back(tea_box, shoot: Shoot, what: str) -> None:
    tracker, states = Tracker({"tea_box": tea_box}), []
    T = _at(0.0)
    if what == "new epoch":  # of a camera whose clock was ahead by an hour
        for number in range(30):
            frame = shoot([(tea_box.mesh, T)], number, epoch=7)
            tracker.step(replace(frame, stamp_ns=frame.stamp_ns + 3_600_000_000_000))
    for number in range(40):
        frame = shoot([(tea_box.mesh, T)] if number < GONE or number >= BACK else [], number)
        if what == "clock set back" and number >= BACK - 3:
            frame = replace(frame, stamp_ns=frame.stamp_ns - 400_000_000)
        tracker.step(frame)
        if number == 0:
            assert tracker.correct(correction(frame, T)) is Applied.APPLIED
        states.append(tracker.poses()[0].state)
        if what == "corrected" and number == GONE - 1:
            beside = se3.perturb(T, np.array([0.004, 0.0, 0.0, 0.0, 0.0, 0.0]))
            said = tracker.correct(correction(frame, beside, seq=2, verdict=Verdict.CORRECT))
            assert said is Applied.APPLIED
    assert states[BACK - 1] is State.LOST
    assert states[-1] is State.TRACKING
    assert states.index(State.TRACKING, BACK) < BACK + 12


def test_a_lost_track_holds_no_frame(tea_box, shoot: Shoot) -> None:
    tracker = Tracker({"tea_box": tea_box})
    for number in range(12):
        frame = shoot([(tea_box.mesh, _at(0.0))] if number < GONE else [], number)
        if number == 0:
            tracker.correct(correction(frame, _at(0.0)))
        (pose,) = tracker.step(frame)
    assert pose.state is State.LOST
    assert tracker._tracks["tea_box", 0].frame is None


def test_while_a_pursuit_waits_for_a_search_no_lost_object_is_searched_for(
    tea_box, soup_can, shoot: Shoot
) -> None:
    """There is time for one search in four frames; the six lost objects would take all of it."""
    tracker = Tracker({"tea_box": tea_box, "soup_can": soup_can})
    boxes = [se3.make(TURNED, np.array([x, y, 0.7])) for x in (-0.17, 0.0, 0.17) for y in (-0.1, 0.1)]
    can, frames = se3.make(TURNED, np.array([0.0, 0.0, 0.6])), []
    for number in range(120):
        scene = [(tea_box.mesh, T) for T in boxes] if number < GONE else [(soup_can.mesh, can)]
        frames.append(shoot(scene, number))
        for k, T in enumerate(boxes if number == 0 else ()):
            tracker.correct(correction(frames[0], T, instance=k))
        if number == 90:
            late = correction(frames[20], can, name="soup_can")
            assert tracker.correct(late) is Applied.CATCHING_UP
        tracker.step(frames[-1])
        if ("soup_can", 0) in tracker.instances:
            break
    assert number < 115


def test_a_start_without_depth_is_doubted_at_once(tea_box, shoot: Shoot) -> None:
    states = []
    for seen in (True, False):
        tracker, frame = Tracker({"tea_box": tea_box}), shoot([(tea_box.mesh, _at(0.0))], 0)
        frame = frame if seen else frame.without(np.ones(frame.depth.shape, bool))
        tracker.step(frame)
        assert tracker.correct(correction(frame, _at(0.0))) is Applied.APPLIED
        states.append(tracker.poses()[0].state)
    assert states == [State.TRACKING, State.SUSPECT]


@pytest.mark.parametrize("remove", [Tracker.remove_instances, Tracker.remove_object])
def test_earlier_corrections_do_not_bring_back_a_removed_object(
    tea_box, shoot: Shoot, remove: Callable[[Tracker, str], None]
) -> None:
    """Not a pursuit under way, not a correction that waits for its frame, and not a late one."""
    frames = [shoot([(tea_box.mesh, _at(0.0))], number) for number in range(14)]
    tracker = Tracker({"tea_box": tea_box})
    for frame in frames[:6]:
        tracker.step(frame)
    assert tracker.correct(correction(frames[0], _at(0.0))) is Applied.CATCHING_UP
    assert tracker.correct(correction(frames[7], _at(0.0), instance=1)) is Applied.CATCHING_UP
    remove(tracker, "tea_box")
    tracker.add_object(tea_box)
    for frame in frames[6:]:
        assert tracker.step(frame) == []
    late = correction(frames[12], _at(0.0), seq=9, verdict=Verdict.CORRECT)
    assert tracker.correct(late) is Applied.REFUSED_OLD
    assert tracker.instances == ()


@pytest.fixture
def looks_at_last_place(monkeypatch) -> list[bool]:
    """For each look at the last position of a lost object, whether it was found there."""
    found: list[bool] = []

    def spied(*args):
        hypotheses = lost.found_at_last_place(*args)
        found.append(bool(hypotheses))
        return hypotheses

    monkeypatch.setattr(track, "found_at_last_place", spied)
    return found


def test_a_lost_object_is_found_in_its_last_position_when_the_occluder_is_gone(
    tea_box, board, shoot: Shoot, searches, looks_at_last_place
) -> None:
    tracker, states = Tracker({"tea_box": tea_box}, TrackerConfig(tries_per_s=0.0)), []
    for number in range(40):
        scene = [(tea_box.mesh, _at(0.0)), *([board] if GONE <= number < BACK else [])]
        frame = shoot(scene, number)
        if number == 0:
            tracker.correct(correction(frame, _at(0.0)))
        states.append(tracker.step(frame)[0].state)
    assert State.LOST in states[:BACK]
    assert states[BACK] is State.SUSPECT
    assert states[BACK + 2 :] == [State.TRACKING] * (40 - BACK - 2)
    assert sum(looks_at_last_place) == 1
    assert sum(searches.values()) <= 1, "there was time for no more"


def test_an_object_that_left_its_last_position_is_looked_for_there_only_once(
    tea_box, shoot: Shoot, looks_at_last_place
) -> None:
    tracker = Tracker({"tea_box": tea_box})
    for number in range(40):
        frame = shoot([(tea_box.mesh, _at(0.0))] if number < GONE else [], number)
        if number == 0:
            tracker.correct(correction(frame, _at(0.0)))
        (pose,) = tracker.step(frame)
    assert pose.state is State.LOST
    assert looks_at_last_place == [False]
