"""The paper's tracker follows a moving box, frame by frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.evaluation.paper_tracker import PaperTracker
from huepose.geometry import RgbdFrame, se3
from huepose.judge.silhouette import visible_mask
from huepose.model.types import ReferenceModel
from huepose.paper.relative_pose import LiftedMatches
from huepose.paper.tracking import PaperStep
from huepose.tracking.types import Applied, Correction, Verdict
from tests.conftest import TakePicture

PERIOD_NS = 33_333_333
Take = Callable[[int], RgbdFrame]


def pose_at(standing: np.ndarray, number: int) -> np.ndarray:
    """The box moves by 4 mm and rotates by 2 degrees a frame."""
    turn = se3.make(se3.rotation_exp(np.radians([0.0, 2.0 * number, 0.0])), np.array([0.004 * number, 0, 0]))
    return standing @ turn


@pytest.fixture(scope="module")
def film(tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray) -> Take:
    def take(number: int) -> RgbdFrame:
        shot = take_picture([(tea_box.mesh, pose_at(standing, number))], frame_id=number)
        return RgbdFrame(shot.color, shot.depth, shot.camera, number, number * PERIOD_NS, 1)

    return take


def right(T: np.ndarray | None, truth: np.ndarray) -> bool:
    assert T is not None
    near = np.linalg.norm(T[:3, 3] - truth[:3, 3]) < 0.004
    return bool(near and se3.rotation_angle(T, truth) < np.radians(2.0))


def test_the_tracker_follows_and_applies_late_poses(
    tea_box: ReferenceModel, film: Take, standing: np.ndarray
) -> None:
    tracker = PaperTracker({"tea_box": tea_box})
    first = Correction.first("tea_box", standing, film(0), 1.0)
    assert tracker.correct(first) is Applied.CATCHING_UP
    for number in range(4):
        (pose,) = tracker.step(film(number))
        assert pose.state is State.TRACKING
        assert right(pose.T_cam_obj, pose_at(standing, number)), number
    # the motions since then move a late pose, here 10 cm off, to the newest frame
    off = se3.compose(se3.make(np.eye(3), np.array([0.1, 0.0, 0.0])), pose_at(standing, 1))
    late = Correction("tea_box", 0, 1, 1, PERIOD_NS, off, 1.0, Verdict.CORRECT, 2)
    before = pose.T_cam_obj
    assert tracker.correct(late) is Applied.APPLIED
    followed = tracker._followed["tea_box", 0]
    assert followed.history.newest is not None
    assert followed.history.newest.T_cam_obj is not None
    moved = followed.history.newest.T_cam_obj[:3, 3] - before[:3, 3]
    assert np.linalg.norm(moved) == pytest.approx(0.1, abs=0.01)
    too_old = Correction("tea_box", 0, 1, -9, -9 * PERIOD_NS, off, 1.0, Verdict.CORRECT, 3)
    assert tracker.correct(too_old) is Applied.REFUSED_OLD


def test_an_object_that_is_found_late_is_tracked_to_the_newest_frame(
    tea_box: ReferenceModel, film: Take, standing: np.ndarray
) -> None:
    tracker = PaperTracker({"tea_box": tea_box})
    for number in range(4):
        assert tracker.step(film(number)) == []
    late = Correction("tea_box", 0, 1, 1, PERIOD_NS, pose_at(standing, 1), 1.0, Verdict.ACQUIRE, 1)
    unheard = replace(late, stamp_ns=PERIOD_NS + 1)
    assert tracker.correct(unheard) is Applied.REFUSED_OLD
    assert tracker.correct(late) is Applied.APPLIED
    (pose,) = tracker.step(film(4))
    assert pose.state is State.TRACKING
    assert pose.applied_correction_seq == 1
    assert right(pose.T_cam_obj, pose_at(standing, 4))


def test_a_late_mask_is_moved_to_the_newest_frame(
    tea_box: ReferenceModel, film: Take, standing: np.ndarray
) -> None:
    tracker = PaperTracker({"tea_box": tea_box})
    tracker.correct(Correction.first("tea_box", standing, film(0), 1.0))
    for number in range(5):
        tracker.step(film(number))
    then, now = (visible_mask(tea_box, film(k), pose_at(standing, k), 0.01) for k in (1, 4))
    pose = pose_at(standing, 1)
    late = Correction("tea_box", 0, 1, 1, PERIOD_NS, pose, 1.0, Verdict.CORRECT, 2, then)
    assert tracker.correct(late) is Applied.APPLIED
    carried = tracker._followed["tea_box", 0].mask
    assert carried is not None
    assert (carried & now).sum() / (carried | now).sum() > 0.9 > (then & now).sum() / (then | now).sum()
    (after,) = tracker.step(film(5))
    assert right(after.T_cam_obj, pose_at(standing, 5))
    assert tracker._followed["tea_box", 0].mask is None


def test_the_given_motion_function_is_used(tea_box: ReferenceModel, film: Take, standing: np.ndarray) -> None:
    seen: list[int] = []

    def known(matches: LiftedMatches) -> np.ndarray:
        seen.append(len(matches))
        T = se3.compose(pose_at(standing, 3), se3.inverse(standing))
        miss = np.linalg.norm(se3.apply(T, matches.points_a) - matches.points_b, axis=1)
        assert np.median(miss) < 0.003, "matches are of the object's motion"
        return T

    T = PaperStep(known)(tea_box, standing, film(0), film(3))
    assert seen[0] > 30
    assert right(T, pose_at(standing, 3))


def test_the_pose_of_an_object_out_of_view_does_not_change(
    tea_box: ReferenceModel, film: Take, standing: np.ndarray
) -> None:
    aside = se3.compose(se3.make(np.eye(3), np.array([3.0, 0.0, 0.0])), standing)
    np.testing.assert_array_equal(PaperStep.of()(tea_box, aside, film(0), film(1)), aside)
