"""A long step must not breed another: in a live pipeline searches are rationed, and everyone gets a turn."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.tracking import Correction, State, Tracker, TrackerConfig, Verdict
from huepose.tracking import step as one_step
from studies.hard_moments.scripts import printed_board

TWO = (0, 1)


@pytest.fixture
def searched(monkeypatch):
    """Names of the surfaces that were searched for, by the real search."""
    seen: list[int] = []
    real = one_step.search

    def search(surface, *rest):
        seen.append(id(surface))
        return real(surface, *rest)

    monkeypatch.setattr(one_step, "search", search)
    return seen


def _tracked(tea_box, soup_can, shoot, path, config):
    """Two objects, acquired in frame 0, and a film of every tenth frame."""
    models = (tea_box, soup_can)

    def place(which, number):
        return se3.compose(se3.make(np.eye(3), np.array([0.12 * (2 * which - 1), 0.0, 0.1])), path(number))

    frames = [shoot([(models[which].mesh, place(which, k)) for which in TWO], k) for k in (0, 10, 20, 30, 40)]
    tracker = Tracker({m.name: m for m in models}, config)
    tracker.step(frames[0])
    for which in TWO:
        first = (frames[0].epoch, 0, frames[0].stamp_ns, place(which, 0), 0.99, Verdict.ACQUIRE, 1)
        tracker.correct(Correction(models[which].name, 0, *first))
    return tracker, frames


def test_without_a_ration_a_long_step_searches_for_all(tea_box, soup_can, shoot, path, searched):
    tracker, frames = _tracked(tea_box, soup_can, shoot, path, TrackerConfig(searches_per_step=None))
    tracker.step(frames[1])
    assert len(set(searched)) == 2


def test_with_a_ration_each_long_step_searches_for_one_and_all_get_their_turn(
    tea_box, soup_can, shoot, path, searched
):
    tracker, frames = _tracked(tea_box, soup_can, shoot, path, TrackerConfig())
    found = []
    for frame in frames[1:]:
        searched.clear()
        tracker.step(frame)
        assert len(set(searched)) <= 1
        found += searched
    assert len(set(found)) == 2


def test_what_comes_in_front_is_not_followed_and_nothing_is_searched_behind_it(
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
            tracker.correct(Correction.first("soup_can", T, frame))
        (pose,) = tracker.step(frame)
        assert (pose.state is State.TRACKING) == (k < 5), k
        if pose.T_cam_obj is not None:
            assert np.linalg.norm(pose.T_cam_obj[:3, 3] - T[:3, 3]) < 0.03, k
    assert searched == []
