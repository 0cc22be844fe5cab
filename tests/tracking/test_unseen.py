"""An object that was out of view for a moment cannot have turned over meanwhile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.judge.terms import NOTHING
from huepose.tracking import Correction, Tracker, TrackerConfig, orientation
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.orientation import Orientation
from huepose.tracking.subject import Subject
from tests.studies.moments import printed_board


def test_after_two_occluded_frames_the_orientation_is_not_questioned(
    tea_box, shoot, path, monkeypatch
) -> None:
    T = path(0)
    board, before = printed_board(0.4, 0.4), se3.make(np.eye(3), np.array([0.0, 0.0, T[2, 3] - 0.2]))
    visible, occluded = [(tea_box.mesh, T)], [(tea_box.mesh, T), (board, before)]
    tracker = Tracker({"tea_box": tea_box})
    tracker.step(shoot(visible, 0))
    tracker.correct(Correction.first("tea_box", T, shoot(visible, 0), 1.0))
    states = [tracker.step(shoot(visible, number))[0].state for number in range(1, 5)]
    assert states == [State.TRACKING] * 4
    asked: list[int] = []

    def spied(subject, first, turns, frame, light):
        asked.append(len(turns))

    monkeypatch.setattr(orientation, "best_rival", spied)
    states = [tracker.step(shoot(occluded, number))[0].state for number in (5, 6)]
    assert states == [State.SUSPECT] * 2
    states = [tracker.step(shoot(visible, number))[0].state for number in range(7, 10)]
    assert states[-1] is State.TRACKING
    assert asked == []


@pytest.mark.parametrize(("leads", "impossible"), [(0.1, True), (0.3, True), (0.4, False)])
def test_an_impossible_rotation_is_taken_if_the_image_outweighs_it(
    tea_box, path, leads: float, impossible: bool
) -> None:
    """Nothing rotates by half a turn within a frame, but timestamps may be wrong."""
    subject, T = Subject.of(tea_box), path(0)
    asked = Orientation(subject, TrackerConfig())
    asked.begin(0.995, subject.viewpoint(T, np.zeros(3)))
    followed = Hypothesis(T, replace(NOTHING, total=0.8), np.zeros((6, 6)), "still")
    found = replace(
        followed, T_cam_obj=T @ tea_box.near_symmetries[1], terms=replace(NOTHING, total=0.8 + leads)
    )
    assert asked.impossible(found, followed, 0.033, 0.0) is impossible
    assert not asked.impossible(replace(found, T_cam_obj=T), followed, 0.033, 0.0), "it did not rotate"


@pytest.mark.parametrize("hz", [15, 30, 90])
def test_the_uncertainty_of_an_unseen_pose_depends_on_the_time_alone(started, shoot, hz: int) -> None:
    """It does not depend on the number of frames in which the object was not visible."""
    (before,) = started.poses()
    frames = [shoot([], 6 + k) for k in range(round(hz * 2 / 15))]
    for k, frame in enumerate(frames):
        (now,) = started.step(replace(frame, stamp_ns=before.stamp_ns + round((k + 1) / hz * 1e9)))
    assert now.covariance is not None
    grown = np.sqrt(np.diag(now.covariance - before.covariance))
    expected = 0.5 * np.repeat([4.0, 20.0], 3) * (2 / 15) ** 2
    np.testing.assert_allclose(grown, expected, rtol=1e-3)
