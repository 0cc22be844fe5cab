"""A lost object is found again anywhere in the image, and nothing is found where it is not."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.tracking import Correction, Tracker, Verdict, lost, stages
from huepose.tracking.elsewhere import likeliest_place
from huepose.tracking.subject import Subject
from huepose.tracking.types import Doubt
from tests.studies.moments import printed_board

HALF_A_SECOND = 15
"""Frames at 30 Hz."""


@pytest.fixture
def asked(monkeypatch) -> list[int]:
    """The parts of the image that were searched, one for each search."""
    parts: list[int] = []
    real = lost.likeliest_place

    def spied(model, table, frame, part):
        parts.append(part)
        return real(model, table, frame, part)

    monkeypatch.setattr(lost, "likeliest_place", spied)
    return parts


def _away(T: np.ndarray, x: float, turn: float = 0.0) -> np.ndarray:
    """The pose moved aside and rotated."""
    return se3.perturb(T, np.array([x, 0.02, 0.05, 0.3 * turn, turn, 0.0]))


def _tracked(model, shoot, T) -> Tracker:
    tracker = Tracker({model.name: model})
    for number in range(4):
        tracker.step(shoot([(model.mesh, T)], number))
        if number == 0:
            tracker.correct(Correction.first(model.name, T, shoot([], 0), 1.0))
    return tracker


def test_the_likeliest_place_is_where_the_object_is(tea_box, soup_can, shoot, path) -> None:
    subject = Subject.of(tea_box)
    for number, x in enumerate((-0.2, 0.0, 0.2)):
        T, other = _away(path(0), x, 0.8 * number), _away(path(0), x - 0.2 if x > 0 else x + 0.2)
        frame = shoot([(tea_box.mesh, T), (soup_can.mesh, other)], number)
        place = likeliest_place(tea_box, subject.views, frame)
        assert place is not None
        assert place.holds(subject.surface.centre_cam(T))


def test_a_lost_object_is_found_on_the_other_side(tea_box, shoot, path) -> None:
    T = path(0)
    tracker, elsewhere = _tracked(tea_box, shoot, _away(T, -0.15)), _away(T, 0.2, 1.2)
    states = [tracker.step(shoot([], number))[0].state for number in range(4, 14)]
    assert states[-1] is State.LOST
    states, doubts = [], []
    for number in range(14, 14 + HALF_A_SECOND):
        (pose,) = tracker.step(shoot([(tea_box.mesh, elsewhere)], number))
        states.append(pose.state)
        doubts.append(tracker.doubt("tea_box", 0))
    assert pose.T_cam_obj is not None
    assert np.linalg.norm(pose.T_cam_obj[:3, 3] - elsewhere[:3, 3]) < 0.005
    assert states[-1] is State.TRACKING
    assert doubts[states.index(State.TRACKING) - 1] is Doubt.FOUND, "SUSPECT at first, and for that alone"
    assert doubts[-1] is None


def test_an_object_that_jumps_is_found_before_it_is_lost_and_confirmed_by_perception(
    tea_box, shoot, path
) -> None:
    T = path(0)
    tracker, elsewhere = _tracked(tea_box, shoot, _away(T, -0.15)), _away(T, 0.2, 1.2)
    for number in range(4, 4 + HALF_A_SECOND):
        frame = shoot([(tea_box.mesh, elsewhere)], number)
        (pose,) = tracker.step(frame)
        assert pose.state is State.SUSPECT, "nothing moves that fast, so it may be another box"
    assert pose.T_cam_obj is not None
    assert np.linalg.norm(pose.T_cam_obj[:3, 3] - elsewhere[:3, 3]) < 0.005
    assert tracker.doubt("tea_box", 0) is Doubt.ANOTHER
    said = Correction.first("tea_box", elsewhere, frame, 0.96)
    tracker.correct(replace(said, verdict=Verdict.AGREE, seq=2))
    (pose,) = tracker.step(shoot([(tea_box.mesh, elsewhere)], number + 1))
    assert pose.state is State.TRACKING


def test_an_object_that_jumps_is_confirmed_by_another_view(tea_box, shoot, path) -> None:
    T = path(0)
    tracker, states = _tracked(tea_box, shoot, _away(T, -0.15)), []
    for number in range(4, 40):
        turned = _away(T, 0.2, 1.2 + 0.04 * (number - 4))
        states.append(tracker.step(shoot([(tea_box.mesh, turned)], number))[0].state)
    assert State.TRACKING not in states[:12]
    assert states[-1] is State.TRACKING


def test_the_place_is_found_in_one_frame_and_searched_in_the_next(tea_box, shoot, path, monkeypatch) -> None:
    done: list[str] = []

    def spied(name, real, *arguments):
        done.append(name)
        return real(*arguments)

    for name in ("likeliest_place", "search"):
        monkeypatch.setattr(stages, name, partial(spied, name, getattr(stages, name)))
    T = path(0)
    tracker, elsewhere = _tracked(tea_box, shoot, _away(T, -0.15)), _away(T, 0.2, 1.2)
    by_frame = []
    for number in range(4, 4 + HALF_A_SECOND):
        done.clear()
        (pose,) = tracker.step(shoot([(tea_box.mesh, elsewhere)], number))
        by_frame.append(tuple(done))
    first = by_frame.index(("likeliest_place",))
    assert by_frame[first + 1] == ("search",)
    assert all(len(one) <= 1 for one in by_frame)
    assert pose.T_cam_obj is not None
    assert np.linalg.norm(pose.T_cam_obj[:3, 3] - elsewhere[:3, 3]) < 0.005


def test_an_absent_object_is_not_found_and_soon_rarely_searched_for(
    tea_box, soup_can, shoot, path, asked
) -> None:
    tracker = _tracked(tea_box, shoot, path(0))
    assert asked == [], "while the object is where it is expected, nothing is searched"
    other = [(soup_can.mesh, _away(path(0), 0.15))]
    states = {tracker.step(shoot(other, number))[0].state for number in range(4, 80)}
    assert states == {State.SUSPECT, State.LOST}
    often = len(asked)
    for number in range(80, 140):
        assert tracker.step(shoot(other, number))[0].state is State.LOST
    assert set(asked) == {0, 1, 2, 3, 4}
    assert len(asked) - often <= 4


def test_a_lost_instance_does_not_take_the_surface_of_another(tea_box, shoot, path) -> None:
    here, gone = _away(path(0), -0.15), _away(path(0), 0.2)
    tracker = Tracker({"tea_box": tea_box})
    both = shoot([(tea_box.mesh, here), (tea_box.mesh, gone)], 0)
    tracker.step(both)
    for instance, T in enumerate((here, gone)):
        first = Correction.first("tea_box", T, both, 1.0)
        tracker.correct(Correction(**{**vars(first), "instance": instance}))
    for number in range(1, 40):
        one, other = tracker.step(shoot([(tea_box.mesh, here)], number))
        assert one.state is State.TRACKING
    assert other.state is State.LOST


def _before(T: np.ndarray) -> tuple:
    """A board half way to the object at this pose; it occludes all of the object."""
    return printed_board(0.15, 0.15), se3.make(np.eye(3), 0.5 * T[:3, 3])


def test_an_object_is_found_elsewhere_while_its_old_position_is_occluded(tea_box, shoot, path) -> None:
    """Every fifth frame comes: the object is occluded in one and in view elsewhere in the next."""
    T = _away(path(0), -0.12)
    tracker, elsewhere, board = _tracked(tea_box, shoot, T), _away(path(0), 0.2, 1.2), _before(T)
    assert tracker.step(shoot([(tea_box.mesh, T), board], 8))[0].state is State.SUSPECT
    (pose,) = tracker.step(shoot([(tea_box.mesh, elsewhere), board], 13))
    assert pose.T_cam_obj is not None
    assert np.linalg.norm(pose.T_cam_obj[:3, 3] - elsewhere[:3, 3]) < 0.005


def test_an_occluded_object_is_not_confused_with_another(tea_box, soup_can, shoot, path) -> None:
    T = _away(path(0), -0.12)
    tracker, board, other = _tracked(tea_box, shoot, T), _before(T), (soup_can.mesh, _away(path(0), 0.2))
    for number in (8, 13, 18):
        (pose,) = tracker.step(shoot([(tea_box.mesh, T), board, other], number))
        assert pose.state is State.SUSPECT
        assert pose.T_cam_obj is not None
        assert np.linalg.norm(pose.T_cam_obj[:3, 3] - T[:3, 3]) < 0.1, number


def test_a_late_frame_is_searched_from_the_cheap_stages_on(tea_box, shoot, path) -> None:
    """In the frame before, which did not show the object, a wide search began and did not end."""
    T = path(0)
    far = se3.make(np.eye(3), np.array([0.1, 0.0, 0.25]))  # Farther than anything moves in that time.
    tracker, elsewhere = _tracked(tea_box, shoot, _away(T, -0.15)), far @ _away(T, 0.15, 1.2)
    tracker.step(shoot([], 8))
    (pose,) = tracker.step(shoot([(tea_box.mesh, elsewhere)], 13))
    assert pose.T_cam_obj is not None
    assert np.linalg.norm(pose.T_cam_obj[:3, 3] - elsewhere[:3, 3]) < 0.005
