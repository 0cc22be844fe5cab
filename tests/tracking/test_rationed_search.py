"""The tracker limits searches per second, so that one slow step does not cause the next; each object gets
its turn."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.tracking import Correction, Tracker, TrackerConfig, Verdict, stages
from tests.studies.moments import printed_board

TWO = (0, 1)


@pytest.fixture
def searched(monkeypatch):
    """The ids of the surfaces searched for, once for each part of a search; the real search runs."""
    seen: list[int] = []
    real = stages.search

    def search(surface, frame, reach, effort, light=None, parts=range(1)):
        seen.extend([id(surface)] * len(parts))
        return real(surface, frame, reach, effort, light, parts)

    monkeypatch.setattr(stages, "search", search)
    return seen


def _tracked(tea_box, soup_can, shoot, path, config, apart):
    """A tracker of two objects, acquired in frame 0, and nine frames. From one to the next the objects move
    by ten frames of `path`, and the frame number grows by `apart`."""
    models = (tea_box, soup_can)

    def place(which, number):
        return se3.compose(se3.make(np.eye(3), np.array([0.12 * (2 * which - 1), 0.0, 0.1])), path(number))

    frames = [
        shoot([(models[which].mesh, place(which, 10 * k)) for which in TWO], apart * k) for k in range(9)
    ]
    tracker = Tracker({m.name: m for m in models}, config)
    tracker.step(frames[0])
    for which in TWO:
        first = (frames[0].epoch, 0, frames[0].stamp_ns, place(which, 0), 0.99, Verdict.ACQUIRE, 1)
        tracker.correct(Correction(models[which].name, 0, *first))
    return tracker, frames


def test_after_a_long_interval_all_objects_are_searched(tea_box, soup_can, shoot, path, searched):
    tracker, frames = _tracked(tea_box, soup_can, shoot, path, TrackerConfig(), 10)
    tracker.step(frames[1])
    assert len(set(searched)) == 2
    assert len(searched) <= 10


def test_after_a_short_interval_one_object_is_searched_and_each_gets_its_turn(
    tea_box, soup_can, shoot, path, searched
):
    tracker, frames = _tracked(tea_box, soup_can, shoot, path, TrackerConfig(), 1)
    found = []
    for frame in frames[1:]:
        searched.clear()
        tracker.step(frame)
        assert len(searched) <= 1
        found += searched
    assert len(set(found)) == 2


def test_without_a_limit_all_objects_are_searched_after_a_short_interval(
    tea_box, soup_can, shoot, path, searched
):
    tracker, frames = _tracked(tea_box, soup_can, shoot, path, TrackerConfig(tries_per_s=None), 1)
    tracker.step(frames[1])
    assert len(set(searched)) == 2


def test_a_search_over_several_frames_finds_an_object_that_was_rotated_behind_a_board(
    soup_can, shoot, path, searched
) -> None:
    """The can is occluded for two frames; then it is rotated by 45 degrees and 3 cm away."""
    board, T = printed_board(0.3, 0.3), path(0)
    turned = se3.perturb(T, np.array([0.03, 0.0, 0.0, 0.0, np.radians(45.0), 0.0]))
    before = se3.make(np.eye(3), np.array([0.0, 0.0, T[2, 3] - 0.15]))
    tracker = Tracker({"soup_can": soup_can})
    for k in range(14):
        scene = [(soup_can.mesh, T if k < 5 else turned)]
        if k in (4, 5):
            scene.append((board, before))
        frame = shoot(scene, k)
        if k == 0:
            tracker.correct(Correction.first("soup_can", T, frame, 1.0))
        searched.clear()
        (pose,) = tracker.step(frame)
        assert len(searched) <= 1, k
    assert pose.state is State.TRACKING
    assert pose.T_cam_obj is not None
    assert np.linalg.norm(pose.T_cam_obj[:3, 3] - turned[:3, 3]) < 0.003
    assert se3.rotation_angle(pose.T_cam_obj, turned) < np.radians(3.0)


def test_an_occluding_board_is_not_tracked_and_nothing_is_searched_behind_it(
    soup_can, shoot, path, searched
) -> None:
    """A board is pushed in front of a can, 15 cm nearer: its depth fits a can in many places."""
    board, T = printed_board(0.3, 0.3), path(0)
    tracker = Tracker({"soup_can": soup_can})
    for k in range(10):
        scene = [(soup_can.mesh, T)]
        if k >= 4:
            x = 0.12 * max(0, 6 - k)
            scene.append((board, se3.make(np.eye(3), np.array([x, 0.0, T[2, 3] - 0.15]))))
        frame = shoot(scene, k)
        if k == 0:
            tracker.correct(Correction.first("soup_can", T, frame, 1.0))
        (pose,) = tracker.step(frame)
        assert (pose.state is State.TRACKING) == (k < 5), k
        if pose.T_cam_obj is not None:
            assert np.linalg.norm(pose.T_cam_obj[:3, 3] - T[:3, 3]) < 0.03, k
    assert searched == []
