"""A camera on a robot hand: a static object is expected where the motion of the camera puts it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import Mesh, RgbdFrame, se3
from huepose.geometry.arrays import Float64
from huepose.tracking import TrackedPose, Tracker, TrackerConfig
from huepose.tracking.track import Track
from tests.tracking.conftest import correction, errors

T_BASE_OBJ = se3.make(se3.rotation_exp(np.array([1.9, 0.3, 0.4])), np.array([0.4, -0.2, 0.1]))
STEP = 6
"""Five frames a second."""

FOLLOWED = ("still", "velocity")
"""Sources of hypotheses that come from no search."""


def camera_at(number: float) -> Float64:
    """T_base_cam of a camera that moves to and fro around the box, half a metre from it: up to 0.5 m/s and 90
    degrees per second."""
    t = number / 30.0
    turn = se3.rotation_exp(np.array([0.35 * np.sin(4.0 * t), 0.4 * np.sin(3.5 * t), 0.5 * np.sin(3.0 * t)]))
    away = np.array([0.1 * np.sin(5.0 * t), 0.08 * np.sin(4.0 * t), 0.55])
    return se3.compose(se3.make(np.eye(3), T_BASE_OBJ[:3, 3]), se3.inverse(se3.make(turn, away)))


def seen_at(number: float) -> Float64:
    """T_cam_obj of the box."""
    return se3.compose(se3.inverse(camera_at(number)), T_BASE_OBJ)


@pytest.fixture
def hand_frame(tea_box, shoot):
    """A function of a frame number: that frame of the moving camera. given: it has its camera pose; front:
    what else is in front of the camera."""

    def take(number: int, given: bool, front: tuple[tuple[Mesh, Float64], ...] = ()) -> RgbdFrame:
        frame = shoot([(tea_box.mesh, seen_at(number)), *front], number)
        return replace(frame, T_parent_cam=camera_at(number) if given else None)

    return take


def _right(pose: TrackedPose) -> bool:
    if pose.T_cam_obj is None or pose.state is not State.TRACKING:
        return False
    mm, degrees = errors(pose, seen_at(pose.frame_id))
    return mm < 2.0 and degrees < 1.0


def test_a_static_object_is_not_searched_for_if_the_camera_pose_is_given(tea_box, hand_frame) -> None:
    searched = {}
    for given in (True, False):
        tracker, sources = Tracker({"tea_box": tea_box}), []
        for number in range(0, 20 * STEP, STEP):
            frame = hand_frame(number, given)
            if number == 0:
                tracker.correct(correction(frame, seen_at(number)))
            (pose,) = tracker.step(frame)
            assert _right(pose) or not given
            sources.append(tracker.hypotheses("tea_box", 0)[0].source)
        searched[given] = len(sources) - sum(source in FOLLOWED for source in sources[1:]) - 1
    assert searched[True] == 0
    assert searched[False] >= 3


@pytest.mark.parametrize("not_given", [(), (7, 8)])
def test_the_velocity_that_is_published_is_relative_to_the_camera(tea_box, hand_frame, not_given) -> None:
    tracker = Tracker({"tea_box": tea_box})
    for number in range(16):
        frame = hand_frame(number, given=number not in not_given)
        if number == 0:
            tracker.correct(correction(frame, seen_at(0)))
        (pose,) = tracker.step(frame)
        if number < 2:
            continue
        assert pose.velocity is not None
        truth = se3.difference(seen_at(number - 1), seen_at(number)) * 30.0
        np.testing.assert_allclose(pose.velocity[:3], truth[:3], atol=0.05, err_msg=str(number))
        np.testing.assert_allclose(pose.velocity[3:], truth[3:], atol=0.3, err_msg=str(number))


@pytest.mark.parametrize("given", [True, False])
def test_an_occluded_pose_follows_the_camera_if_the_camera_pose_is_given(
    tea_box, board, hand_frame, given
) -> None:
    tracker, off_mm = Tracker({"tea_box": tea_box}), []
    for number in range(18):
        # The board comes while the camera moves to one side; that motion ends while the box is occluded.
        frame = hand_frame(number, given, (board,) if number >= 10 else ())
        if number == 0:
            tracker.correct(correction(frame, seen_at(0)))
        (pose,) = tracker.step(frame)
        if number >= 10 and pose.T_cam_obj is not None:
            assert pose.state is State.SUSPECT
            off_mm.append(errors(pose, seen_at(number))[0])
    assert len(off_mm) >= 4
    assert (max(off_mm) < 10.0) == given


def test_single_frames_without_a_camera_pose_do_no_harm(tea_box, hand_frame) -> None:
    tracker = Tracker({"tea_box": tea_box})
    for number in range(20):
        frame = hand_frame(number, given=number % 5 != 3)
        if number == 0:
            tracker.correct(correction(frame, seen_at(0)))
        (pose,) = tracker.step(frame)
        assert _right(pose), number


@pytest.fixture
def rotating(tea_box, shoot):
    """A function of a frame number: the frame of a camera that rotates by 60 degrees to one side and back in
    45 frames, and the pose of the box in it."""
    T_base_obj = se3.make(T_BASE_OBJ[:3, :3], np.array([0.0, 0.0, 0.55]))

    def take(number: int, given: bool) -> tuple[RgbdFrame, Float64]:
        angle = np.radians(60.0) * np.sin(np.pi * number / 45.0) ** 2
        T_base_cam = se3.make(se3.rotation_exp(np.array([0.0, angle, 0.0])), np.zeros(3))
        T_cam_obj = se3.compose(se3.inverse(T_base_cam), T_base_obj)
        frame = shoot([(tea_box.mesh, T_cam_obj)], number)
        return replace(frame, T_parent_cam=T_base_cam if given else None), T_cam_obj

    return take


@pytest.mark.parametrize(
    ("not_given", "back"), [((), True), ((25, 27), True), (range(25, 29), True), (range(46), False)]
)
def test_an_object_that_the_camera_looked_away_from_is_tracked_again_at_once(
    tea_box, rotating, not_given, back
) -> None:
    """There is no time for any search."""
    tracker, states = Tracker({"tea_box": tea_box}, TrackerConfig(tries_per_s=0.0)), []
    for number in range(46):
        frame, T_cam_obj = rotating(number, number not in not_given)
        if number == 0:
            tracker.correct(correction(frame, T_cam_obj))
        (pose,) = tracker.step(frame)
        states.append(pose.state)
    assert states[22] is State.LOST
    assert (states[-1] is State.TRACKING) == back
    if back:
        mm, degrees = errors(pose, T_cam_obj)
        assert mm < 2.0
        assert degrees < 1.0


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("behind", [22, 35])
def test_an_answer_from_before_the_camera_looked_away_is_used(tea_box, rotating, given, behind) -> None:
    """The answer comes while the object is out of view, or when it is in view again."""
    tracker, known = Tracker({"tea_box": tea_box}), []
    first, T_first = rotating(0, given)
    for number in range(46):
        frame, T_cam_obj = rotating(number, given)
        known = tracker.step(frame)
        if number == behind:
            tracker.correct(correction(first, T_first, seq=7))
        if number == 33 and behind == 22:
            assert [pose.applied_correction_seq for pose in known] == [7] * given, "it is not sent again"
    assert bool(known) == given
    if given:
        assert known[0].state is State.TRACKING
        mm, degrees = errors(known[0], T_cam_obj)
        assert mm < 2.0
        assert degrees < 1.0


@pytest.mark.parametrize("given", [True, False])
def test_a_static_object_is_caught_up_in_a_few_looks(tea_box, hand_frame, monkeypatch, given) -> None:
    look, looks = Track.look, []
    monkeypatch.setattr(Track, "look", lambda track, *args: looks.append(track) or look(track, *args))
    tracker = Tracker({"tea_box": tea_box})
    frames = [hand_frame(number, given) for number in range(45)]
    for number, frame in enumerate(frames):
        poses = tracker.step(frame)
        if number == 30:
            tracker.correct(correction(frames[0], seen_at(0)))
        if poses:
            break
    assert _right(poses[0])
    assert (len(looks) <= 5) == given


@pytest.mark.parametrize("jump_m", [0.3, 5.0, 1e7])
def test_a_jump_of_the_parent_frame_is_no_motion(tea_box, hand_frame, jump_m) -> None:
    tracker = Tracker({"tea_box": tea_box})
    jump = se3.make(np.eye(3), np.array([0.0, jump_m, 0.0]))
    for number in range(12):
        frame = hand_frame(number, given=True)
        if number >= 6:
            frame = replace(frame, T_parent_cam=jump @ frame.T_parent_cam)
        if number == 0:
            tracker.correct(correction(frame, seen_at(0)))
        (pose,) = tracker.step(frame)
        assert _right(pose), number
