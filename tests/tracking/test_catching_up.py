"""How a late pose is tracked forward to the newest frame: in which strides, and how it is verified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.tracking import Applied, Correction, Tracker, TrackerConfig, Verdict
from huepose.tracking.catching_up import Pursuit
from huepose.tracking.subject import Subject
from huepose.tracking.track import Track

LATE = 12
"""How many frames an answer of perception is behind: 0.4 s at 30 Hz."""

CONFIG = TrackerConfig(tries_per_s=None, catch_up_stride=5)
LIVE = TrackerConfig()


def late(frame, T, stamp_ns=None) -> Correction:
    stamp = frame.stamp_ns if stamp_ns is None else stamp_ns
    return Correction("tea_box", 0, frame.epoch, frame.frame_id, stamp, T, 0.95, Verdict.ACQUIRE, 1)


@pytest.fixture(scope="module")
def whirled(tea_box, shoot):
    """The frames of a box that is swung around at 0.6 m/s, its poses, and as many frames without it."""

    def at(number: int) -> np.ndarray:
        t = number / 30.0
        turn = se3.rotation_exp(np.array([0.6, 3.0, 0.9]) * t) @ se3.rotation_exp(np.array([1.9, 0.3, 0.4]))
        return se3.make(turn, np.array([0.06 * np.cos(10.0 * t), 0.036 * np.sin(10.0 * t), 0.6]))

    numbers = range(LATE + 20)
    frames = [shoot([(tea_box.mesh, at(k))], k) for k in numbers]
    return frames, [at(k) for k in numbers], [shoot([], k) for k in numbers]


def test_of_poses_that_look_the_same_a_pursuit_follows_the_one_nearest_to_the_last(
    tea_box, film, path
) -> None:
    """The rotation of a round object that a robot follows does not jump when perception finds it again."""
    half = se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    model, frames = replace(tea_box, equivalents=np.stack([np.eye(4), half])), film(4)
    for lost in (False, True):
        tracker = Tracker({"tea_box": model})
        tracker.correct(Correction.first("tea_box", path(0), frames[0], 1.0))
        for frame in frames:
            tracker.step(frame)
        track = tracker._tracks["tea_box", 0]
        if lost:
            track.lose()
        pursuit = Pursuit(late(frames[-1], path(3) @ half), track.subject, LIVE, track)
        assert np.allclose(pursuit.correction.T_cam_obj, path(3))


@pytest.mark.parametrize("behind", [1, 3, 6, 12])
def test_a_pursuit_reaches_the_newest_frame_in_few_strides(tea_box, shoot, path, behind) -> None:
    subject = Subject.of(tea_box)
    frames = [shoot([(tea_box.mesh, path(k))], k) for k in range(behind + 1)]
    pursuit, steps = Pursuit(late(frames[0], path(0)), subject, CONFIG), 0
    while not pursuit.arrived(frames[-1]):
        since = frames[0] if pursuit.track.frame is None else pursuit.track.frame
        pursuit.follow([f for f in frames if f.stamp_ns >= since.stamp_ns])
        steps += 1
        assert steps <= 5
    assert pursuit.supported
    T = pursuit.track.T_cam_obj
    assert T is not None
    assert np.linalg.norm(T[:3, 3] - path(behind)[:3, 3]) < 1e-3
    assert se3.rotation_angle(T, path(behind)) < np.radians(0.4)
    stamps = [stamp for stamp, _ in pursuit.poses]
    assert stamps == sorted(stamps)
    assert stamps[-1] == frames[-1].stamp_ns


def test_no_stride_is_longer_than_allowed(tea_box, shoot, path) -> None:
    subject = Subject.of(tea_box)
    frames = [shoot([(tea_box.mesh, path(k))], k) for k in range(13)]
    pursuit = Pursuit(late(frames[0], path(0)), subject, CONFIG)
    pursuit.follow(frames)
    assert pursuit.track.frame is frames[CONFIG.catch_up_stride]


def test_a_pose_of_a_skipped_frame_is_refined_in_the_next_one(tea_box, shoot, path) -> None:
    subject = Subject.of(tea_box)
    frames = [shoot([(tea_box.mesh, path(k))], k) for k in (2, 3, 4)]
    correction = late(frames[0], path(1.5), stamp_ns=50_000_000)
    pursuit = Pursuit(correction, subject, CONFIG)
    pursuit.follow(frames)
    assert pursuit.poses[0][0] == frames[0].stamp_ns
    assert np.linalg.norm(pursuit.poses[0][1][:3, 3] - path(2)[:3, 3]) < 1e-3
    assert pursuit.arrived(frames[-1])


def test_a_pose_that_the_image_contradicts_is_not_supported(tea_box, shoot, path) -> None:
    frame = shoot([])
    pursuit = Pursuit(late(frame, path(0)), Subject.of(tea_box), CONFIG)
    pursuit.follow([frame])
    assert pursuit.arrived(frame)
    assert not pursuit.supported


@pytest.mark.parametrize("looked_at", [12, 15])
def test_an_answer_that_is_seconds_late_is_used(tea_box, shoot, path, looked_at) -> None:
    """Of the oldest frames the history keeps only every sixth: 12 is kept, 15 is not."""
    tracker = Tracker({"tea_box": tea_box}, LIVE)
    frames = [shoot([(tea_box.mesh, path(k))], k) for k in range(132)]
    for frame in frames[:91]:
        assert tracker.step(frame) == []
    correction = late(frames[looked_at], path(looked_at))
    assert tracker.correct(correction) is Applied.CATCHING_UP
    for number in range(91, 132):
        poses = tracker.step(frames[number])
        if poses:
            break
    assert number < 125
    assert tracker.reach_s is None, "the tracker began less than four seconds ago"
    assert poses[0].state is State.TRACKING
    assert np.linalg.norm(poses[0].T_cam_obj[:3, 3] - path(number)[:3, 3]) < 2e-3
    assert se3.rotation_angle(poses[0].T_cam_obj, path(number)) < np.radians(1.0)
    assert tracker.correct(replace(correction, seq=2, stamp_ns=-1)) is Applied.REFUSED_OLD


@pytest.mark.parametrize("rests_until", [60, 14])
def test_a_static_object_is_caught_up_in_a_few_looks(tea_box, shoot, path, monkeypatch, rests_until) -> None:
    """Also if it was lifted meanwhile, which the long strides do not expect."""
    look, looks = Track.look, []
    monkeypatch.setattr(Track, "look", lambda track, *args: looks.append(track) or look(track, *args))
    truth = [path(max(k - rests_until, 0)) for k in range(60)]
    frames = [shoot([(tea_box.mesh, T)], k) for k, T in enumerate(truth)]
    tracker = Tracker({"tea_box": tea_box}, LIVE)
    for frame in frames[:36]:
        tracker.step(frame)
    tracker.correct(late(frames[0], truth[0]))
    for number in range(36, 60):
        poses = tracker.step(frames[number])
        if poses:
            break
    assert poses[0].state is State.TRACKING
    assert np.linalg.norm(poses[0].T_cam_obj[:3, 3] - truth[number][:3, 3]) < 2e-3
    assert len(looks) <= (5 if rests_until == 60 else 16)


def test_an_object_too_fast_for_a_long_stride_is_caught_up(tea_box, whirled, monkeypatch) -> None:
    """Each live frame takes at most two looks, also if a stride has to be undone."""
    frames, truth, _ = whirled
    look, looks = Track.look, []
    monkeypatch.setattr(Track, "look", lambda track, *args: looks.append(track) or look(track, *args))
    tracker = Tracker({"tea_box": tea_box}, LIVE)
    for frame in frames[:LATE]:
        assert tracker.step(frame) == []
    tracker.correct(late(frames[0], truth[0]))
    published = []
    for frame in frames[LATE:]:
        looks.clear()
        published.append(tracker.step(frame))
        assert len(looks) <= 2
    reached = next(k for k, poses in enumerate(published) if poses)
    assert 2 <= reached <= 8
    for number, poses in enumerate(published[reached:], LATE + reached):
        assert poses[0].state is State.TRACKING
        assert np.linalg.norm(poses[0].T_cam_obj[:3, 3] - truth[number][:3, 3]) < 2e-3


def test_a_stride_that_lost_the_object_is_undone_and_strides_grow_again(tea_box, whirled) -> None:
    frames, truth, _ = whirled
    pursuit, reached = Pursuit(late(frames[0], truth[0]), Subject.of(tea_box), LIVE), [0]
    for now in range(LATE, len(frames)):
        pursuit.follow(frames[reached[-1] : now + 1], 1.0)
        assert pursuit.supported
        reached.append(pursuit.track.frame.frame_id)
        if pursuit.arrived(frames[now]):
            break
    assert reached[:5] == [0, 0, 1, 3, 6], "the first stride lost it"
    assert reached[-1] == now
    stamps = [stamp for stamp, _ in pursuit.poses]
    assert stamps == sorted(set(stamps))


@pytest.mark.parametrize("moved", [False, True])
def test_only_a_camera_that_moved_has_turned_away(tea_box, whirled, moved) -> None:
    """A hand in front of a static camera occludes the object as well."""
    frames, truth, empty = whirled
    T_room_cam = se3.make(np.eye(3), np.array([0.0, 0.003 if moved else 0.0005, 0.0]))
    occluded = [
        replace(f, depth=np.full_like(f.depth, 0.2), T_parent_cam=T_room_cam) for f in empty[1 : LATE + 1]
    ]
    film = [replace(frames[0], T_parent_cam=np.eye(4)), *occluded]
    pursuit = Pursuit(late(frames[0], truth[0]), Subject.of(tea_box), LIVE)
    pursuit.follow(film)
    assert pursuit.turned_away == moved


def test_a_pursuit_that_loses_the_object_repeatedly_is_given_up(tea_box, whirled) -> None:
    """The object vanishes on the way, and a second long stride comes no nearer to the newest frame."""
    frames, truth, empty = whirled
    film = [*frames[:5], *empty[5:]]
    pursuit, reached = Pursuit(late(frames[0], truth[0]), Subject.of(tea_box), LIVE), 0
    for now in range(LATE, LATE + 8):
        pursuit.follow(film[reached : now + 1])
        reached = pursuit.track.frame.frame_id
        if not pursuit.supported:
            break
    assert not pursuit.supported
    assert reached == 6


@pytest.mark.parametrize("wrong", ["elsewhere", "turned", "turned over", "absent"])
def test_a_wrong_answer_about_a_fast_object_is_never_tracking(tea_box, whirled, wrong) -> None:
    frames, truth, empty = whirled
    T = truth[0].copy()
    if wrong == "elsewhere":
        T[:3, 3] += (-0.15, 0.02, 0.1)
    elif wrong != "absent":
        radians = np.pi if wrong == "turned over" else np.pi / 2
        T[:3, :3] = T[:3, :3] @ se3.rotation_exp(np.array([radians, 0.0, 0.0]))
    shown = empty if wrong == "absent" else frames
    tracker = Tracker({"tea_box": tea_box}, LIVE)
    for frame in shown[:LATE]:
        tracker.step(frame)
    tracker.correct(late(shown[0], T))
    for number, frame in enumerate(shown[LATE:], LATE):
        for pose in tracker.step(frame):
            right = np.linalg.norm(pose.T_cam_obj - truth[number]) < 0.05
            assert (right and wrong != "absent") or pose.state is not State.TRACKING
