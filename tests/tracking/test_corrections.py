"""How the tracker applies perception's answers about past frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.estimation import PoseEstimate
from huepose.geometry import se3
from huepose.support.errors import InputError
from huepose.tracking import Applied, Correction, Tracker, TrackerConfig, Verdict
from tests.tracking.conftest import correction, errors


def test_a_late_perfect_pose_replays_exactly(started, film, path) -> None:
    """The output is the truth at the corrected frame, composed with the increments tracked since then."""
    track = started._tracks["tea_box", 0]
    before = [e.T_cam_obj for e in track.history]
    late = 2
    corrected = correction(film(6)[late], path(late), seq=2, verdict=Verdict.CORRECT)
    assert started.correct(corrected) is Applied.APPLIED
    expected = before[-1] @ se3.inverse(before[late]) @ path(late)
    (pose,) = started.poses()
    np.testing.assert_allclose(pose.T_cam_obj, expected, atol=1e-12)
    assert pose.applied_correction_seq == 2


def test_of_poses_that_look_the_same_a_correction_keeps_the_one_that_was_followed(
    tea_box, film, path
) -> None:
    """In the poses of all frames since then, not only in the last one."""
    half = se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    tracker = Tracker({"tea_box": replace(tea_box, equivalents=np.stack([np.eye(4), half]))})
    frames = film(4)
    tracker.correct(Correction.first("tea_box", path(0), frames[0], 1.0))
    for frame in frames:
        tracker.step(frame)
    other = correction(frames[2], path(2) @ half, 2, Verdict.CORRECT)
    assert tracker.correct(other) is Applied.APPLIED
    (pose,) = tracker.poses()
    track = tracker._tracks["tea_box", 0]
    for T, number in ((pose.T_cam_obj, 3), (track.pose_near(frames[2].stamp_ns), 2)):
        assert se3.rotation_angle(T, path(number)) < np.radians(0.5)


def test_a_small_correction_does_not_make_a_sure_object_doubtful(started, film, path) -> None:
    frames = film(8)
    near = correction(frames[4], path(4), 2, Verdict.CORRECT, quality=0.5)
    assert started.correct(near) is Applied.APPLIED
    assert started.step(frames[6])[0].state is State.TRACKING
    flipped = path(5) @ se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    started.correct(correction(frames[5], flipped, 3, Verdict.CORRECT, quality=0.5))
    (pose,) = started.step(frames[7])
    assert errors(pose, path(7))[1] < 1.0, "the image outweighs the correction"
    assert pose.state is State.TRACKING


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_correction_that_leads_back_to_the_tracked_pose_is_no_doubt(
    tea_box, started, film, path, axis, side
) -> None:
    """Both poses converge to the same one, so it does not matter which of the two explains more."""
    frames, off = film(8), np.eye(4)
    off[axis, 3] = side * 0.09 * tea_box.diameter_m
    assert started.correct(correction(frames[4], off @ path(4), 2, Verdict.CORRECT)) is Applied.APPLIED
    for frame in frames[6:]:
        (pose,) = started.step(frame)
        assert pose.state is State.TRACKING
        assert errors(pose, path(frame.frame_id))[0] < 2.5


def test_corrections_are_idempotent_by_number(started, film, path) -> None:
    frame = film(6)[3]
    assert started.correct(correction(frame, path(3), 2, Verdict.CORRECT)) is Applied.APPLIED
    first = started.poses()[0].T_cam_obj
    assert started.correct(correction(frame, path(3), 2, Verdict.CORRECT)) is Applied.REPEATED
    assert started.correct(correction(frame, path(0), 1, Verdict.CORRECT)) is Applied.REPEATED
    np.testing.assert_array_equal(started.poses()[0].T_cam_obj, first)


@pytest.mark.parametrize("number", [0, -3])
def test_corrections_are_numbered_from_any_number_on(tea_box, film, path, number) -> None:
    tracker, (first, second) = Tracker({"tea_box": tea_box}), film(2)
    assert tracker.correct(correction(first, path(0), number)) is Applied.CATCHING_UP
    assert tracker.step(first)[0].state is State.TRACKING
    assert tracker.correct(correction(first, path(0), number)) is Applied.REPEATED
    assert tracker.step(second)[0].state is State.TRACKING


def test_corrections_that_cannot_be_applied_are_refused(tea_box, film, path, started) -> None:
    old = film(1)[0]
    tracker = Tracker({"tea_box": tea_box}, TrackerConfig(history_frames=3, older_frames=0))
    for frame in film(6):
        if frame.frame_id == 0:
            tracker.correct(correction(frame, path(0)))
        tracker.step(frame)
    late = correction(old, path(0), 2, Verdict.CORRECT)
    assert tracker.correct(late) is Applied.REFUSED_OLD
    assert tracker.reach_s == pytest.approx(2 / 30)
    assert started.correct(late) is Applied.APPLIED, "a longer history still knows it"
    foreign = Correction("tea_box", 0, 9, 5, film(6)[5].stamp_ns, path(5), 0.9, Verdict.CORRECT, 3)
    assert started.correct(foreign) is Applied.REFUSED_EPOCH
    with pytest.raises(InputError, match="tea_cup"):
        started.correct(correction(old, path(0), name="tea_cup"))
    for asked in (started.surface, started.contours):
        with pytest.raises(InputError, match=r"found object 'tea_cup'; expected one of tea_box\. Add the"):
            asked("tea_cup")


def test_a_skipped_frame_is_corrected_between_its_neighbours(tea_box, film, path) -> None:
    tracker = Tracker({"tea_box": tea_box})
    frames = film(7)
    for k in (0, 1, 2, 4, 6):
        if k == 0:
            tracker.correct(correction(frames[0], path(0)))
        tracker.step(frames[k])
    assert tracker.correct(correction(frames[3], path(3), 2, Verdict.CORRECT)) is Applied.APPLIED
    mm, degrees = errors(tracker.poses()[0], path(6))
    assert mm < 2.5
    assert degrees < 1.5


def test_a_large_correction_is_caught_up_before_it_is_published(tea_box, shoot, path) -> None:
    """The tracker follows the left one of two boxes; six frames ago perception saw the right one."""
    left, right = np.array([-0.1, 0.0, 0.05]), np.array([0.1, 0.0, 0.05])

    def at(k: int, place: np.ndarray) -> np.ndarray:
        return se3.make(path(k)[:3, :3], path(k)[:3, 3] + place)

    tracker = Tracker({"tea_box": tea_box})
    frames = [shoot([(tea_box.mesh, at(k, left)), (tea_box.mesh, at(k, right))], k) for k in range(8)]
    tracker.correct(correction(frames[0], at(0, left)))
    for frame in frames:
        tracker.step(frame)
    here = tracker.poses()[0].T_cam_obj
    there = correction(frames[2], at(2, right), 2, Verdict.CORRECT)
    assert tracker.correct(there) is Applied.CATCHING_UP
    np.testing.assert_array_equal(tracker.poses()[0].T_cam_obj, here)
    assert tracker.correct(there) is Applied.REPEATED
    for k in range(8, 12):
        # The left one is gone now, so the correction explains more than the tracked pose.
        (pose,) = tracker.step(shoot([(tea_box.mesh, at(k, right))], k))
        assert pose.applied_correction_seq == 2 or errors(pose, at(k, right))[0] > 100
        if pose.applied_correction_seq == 2:
            break
    assert pose.applied_correction_seq == 2
    assert pose.state is State.TRACKING
    assert errors(pose, at(k, right))[0] < 1.5


def test_a_late_acquisition_catches_up_with_a_moving_object(tea_box, film, path) -> None:
    tracker = Tracker({"tea_box": tea_box})
    frames = film(14)
    for frame in frames[:8]:
        assert tracker.step(frame) == []
    assert tracker.correct(correction(frames[1], path(1))) is Applied.CATCHING_UP
    assert tracker.poses() == [], "unpublished until it has reached now"
    published = [tracker.step(frame) for frame in frames[8:]]
    reached = next(k for k, p in enumerate(published) if p)
    assert reached <= 2
    (pose,) = published[reached]
    assert pose.state is State.TRACKING
    assert errors(pose, path(8 + reached))[0] < 1.0
    assert errors(published[-1][0], path(13))[0] < 1.0


def test_an_acquisition_that_the_image_contradicts_is_dropped(tea_box, shoot, path) -> None:
    tracker = Tracker({"tea_box": tea_box})
    empty = shoot([], 0)
    tracker.correct(correction(empty, path(0)))
    assert tracker.step(empty) == []
    assert tracker.instances == ()


@pytest.mark.parametrize("later_ns", [0, -(10**10)])
def test_a_doubtful_acquisition_is_suspect_until_perception_agrees(tea_box, film, path, later_ns) -> None:
    """Whatever moment the timestamps are counted from."""
    tracker = Tracker({"tea_box": tea_box})
    frames = [replace(frame, stamp_ns=frame.stamp_ns + later_ns) for frame in film(5)]
    tracker.correct(correction(frames[0], path(0), quality=0.6))
    for frame in frames[:3]:
        assert tracker.step(frame)[0].state is State.SUSPECT
    assert tracker.poses()[0].quality < 0.65
    for seq in (2, 3):
        agreed = correction(frames[seq - 1], path(seq - 1), seq, Verdict.AGREE, quality=0.9)
        assert tracker.correct(agreed) is Applied.APPLIED
        (pose,) = tracker.step(frames[1 + seq])
        # One error in ten is too many.
        assert pose.state is (State.SUSPECT if seq == 2 else State.TRACKING)
        assert pose.applied_correction_seq == seq
    assert pose.quality > 0.8


@pytest.mark.parametrize(
    ("quality", "present", "state"),
    [
        (0.91, 0.99, State.TRACKING),  # it is there, and no other orientation fits as well
        (0.91, 0.93, State.SUSPECT),  # one in fourteen times it is something else
        (0.8, 0.99, State.SUSPECT),  # it is there, in one of several poses
    ],
)
def test_one_answer_is_enough_if_presence_and_orientation_are_certain(
    tea_box, film, path, quality, present, state
) -> None:
    tracker = Tracker({"tea_box": tea_box})
    frames = film(3)
    tracker.correct(replace(correction(frames[0], path(0), quality=quality), present=present))
    (pose,) = [tracker.step(frame)[0] for frame in frames][-1:]
    assert pose.state is state


def test_an_object_that_perception_doubts_repeatedly_stays_suspect(tea_box, film, path) -> None:
    tracker = Tracker({"tea_box": tea_box})
    frames = film(12)
    tracker.correct(correction(frames[0], path(0), quality=0.6))
    tracker.step(frames[0])
    for number in range(1, 12):
        tracker.correct(correction(frames[number - 1], path(number - 1), number + 1, Verdict.AGREE, 0.3))
        (pose,) = tracker.step(frames[number])
        assert pose.state is State.SUSPECT, number
    assert pose.quality < 0.65


@pytest.mark.parametrize(("present", "state"), [(0.9, State.SUSPECT), (0.97, State.TRACKING)])
def test_answers_from_one_viewpoint_confirm_no_more_than_the_surest(
    tea_box, film, path, present, state
) -> None:
    tracker = Tracker({"tea_box": tea_box})
    frames = film(8)
    for number in range(7):
        verdict = Verdict.AGREE if number else Verdict.ACQUIRE
        said = correction(frames[number], path(number), number + 1, verdict, quality=0.88)
        tracker.correct(replace(said, present=present))
        tracker.step(frames[number])
    (pose,) = tracker.step(frames[7])
    assert pose.state is state


def test_more_answers_about_one_frame_add_nothing(tea_box, film, path) -> None:
    tracker = Tracker({"tea_box": tea_box})
    frames = film(2)
    tracker.correct(correction(frames[0], path(0), quality=0.6))
    tracker.step(frames[0])
    for seq in range(2, 8):
        tracker.correct(correction(frames[0], path(0), seq, Verdict.AGREE, quality=0.8))
    (pose,) = tracker.step(frames[1])
    assert pose.state is State.SUSPECT
    assert pose.quality < 0.85


def test_an_answer_about_an_earlier_frame_does_not_change_the_usual_total(tea_box, film, shoot, path) -> None:
    tracker = Tracker({"tea_box": tea_box})
    frames = film(4)
    tracker.correct(correction(frames[0], path(0)))
    for frame in frames:
        tracker.step(frame)
    track = tracker._tracks["tea_box", 0]
    usual = track.belief.usual.baseline
    tracker.step(shoot([], 4))
    assert track.terms.total < 0.2
    tracker.correct(correction(frames[3], path(3), 2, Verdict.AGREE))
    assert track.belief.usual.baseline == usual


def test_the_usual_total_does_not_fall_while_half_of_the_object_is_occluded(
    tea_box, soup_can, film, shoot, path
) -> None:
    """Neither by frames in which it is TRACKING, nor by an answer of perception."""
    tracker, frames = Tracker({"tea_box": tea_box}), film(4)
    tracker.correct(correction(frames[0], path(0)))
    for frame in frames:
        tracker.step(frame)
    track = tracker._tracks["tea_box", 0]
    usual = track.belief.usual.baseline
    assert usual is not None
    before = se3.make(np.eye(3), path(4)[:3, 3] * 0.75 + (0.035, 0.0, 0.0))
    for number in range(4, 14):
        frame = shoot([(tea_box.mesh, path(4)), (soup_can.mesh, before)], number)
        (pose,) = tracker.step(frame)
    assert pose.state is State.TRACKING
    assert 0.3 < track.terms.hidden < 0.6
    assert track.terms.total < usual - 0.02
    tracker.correct(correction(frame, path(4), 2, Verdict.AGREE))
    assert track.belief.usual.baseline is not None
    assert track.belief.usual.baseline >= usual


_SHEARED = np.eye(4) + 0.2 * np.eye(4, k=1)


@pytest.mark.parametrize(
    ("given", "found"),
    [
        (None, r"found None; .*Ask `pose\.found` first"),
        (np.eye(3), r"found a ndarray of shape \(3, 3\)"),
        (np.full((4, 4), np.nan), "found numbers that are not finite"),
        (np.zeros((4, 4)), "found a matrix that is no rotation and translation: 0 0 0 0"),
        (_SHEARED, "found a matrix that is no rotation and translation: 1 0.2 0 0"),
        ([[1.0, 0.0], [0.0]], "found a list;"),
        ("tea_box", "found a str;"),
    ],
)
def test_a_first_correction_without_a_valid_pose_is_refused(film, given, found) -> None:
    with pytest.raises(InputError, match=f"'tea_box': {found}") as caught:
        Correction.first("tea_box", given, film(1)[0], 1.0)
    assert "expected a rigid transform (4, 4)" in str(caught.value)


@pytest.mark.parametrize("quality", [np.nan, -0.1, 95.0])
def test_a_quality_that_is_no_probability_is_refused(film, path, quality) -> None:
    with pytest.raises(InputError, match=f"quality of .* 'tea_box': found {quality}; expected a probability"):
        Correction.first("tea_box", path(0), film(1)[0], quality)


def test_a_pose_as_lists_or_float32_starts_a_track(tea_box, film, path) -> None:
    frame = film(1)[0]
    for given in (path(0).tolist(), path(0).astype(np.float32)):
        tracker = Tracker({"tea_box": tea_box})
        tracker.correct(Correction.first("tea_box", given, frame, 1.0))
        (pose,) = tracker.step(frame)
        assert errors(pose, path(0))[1] < 1.0


def test_a_correction_from_an_estimate_takes_its_quality(film, path) -> None:
    frame = film(3)[2]
    found = PoseEstimate("tea_box", 4, True, path(2), quality=0.3, reason="Hidden.", present=0.9)
    said = Correction.of(found, frame)
    assert (said.key, said.frame_id, said.stamp_ns) == (("tea_box", 4), 2, frame.stamp_ns)
    assert (said.quality, said.reason, said.verdict) == (0.3, "Hidden.", Verdict.ACQUIRE)
    assert said.present == 0.9
    np.testing.assert_array_equal(said.T_cam_obj, path(2))
    with pytest.raises(InputError, match=r"Ask `pose\.found` first"):
        Correction.of(PoseEstimate("tea_box"), frame)
