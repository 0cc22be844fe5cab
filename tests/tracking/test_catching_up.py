"""How a late pose comes to now: by which strides, and verified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.tracking import Applied, Correction, State, Tracker, TrackerConfig, Verdict
from huepose.tracking.catching_up import Pursuit
from huepose.tracking.subject import Subject

CONFIG = TrackerConfig(tries_per_s=None, catch_up_stride=5)
LIVE = TrackerConfig()


def late(frame, T, stamp_ns=None) -> Correction:
    stamp = frame.stamp_ns if stamp_ns is None else stamp_ns
    return Correction("tea_box", 0, frame.epoch, frame.frame_id, stamp, T, 0.95, Verdict.ACQUIRE, 1)


@pytest.mark.parametrize("behind", [1, 3, 6, 12])
def test_it_reaches_now_in_few_strides(tea_box, shoot, path, behind) -> None:
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


def test_a_frame_that_was_skipped_settles_on_the_next_one(tea_box, shoot, path) -> None:
    subject = Subject.of(tea_box)
    frames = [shoot([(tea_box.mesh, path(k))], k) for k in (2, 3, 4)]
    correction = late(frames[0], path(1.5), stamp_ns=50_000_000)
    pursuit = Pursuit(correction, subject, CONFIG)
    pursuit.follow(frames)
    assert pursuit.poses[0][0] == frames[0].stamp_ns
    assert np.linalg.norm(pursuit.poses[0][1][:3, 3] - path(2)[:3, 3]) < 1e-3
    assert pursuit.arrived(frames[-1])


def test_what_the_image_denies_is_not_supported(tea_box, shoot, path) -> None:
    frame = shoot([])
    pursuit = Pursuit(late(frame, path(0)), Subject.of(tea_box), CONFIG)
    pursuit.follow([frame])
    assert pursuit.arrived(frame)
    assert not pursuit.supported


@pytest.mark.parametrize("looked_at", [12, 15])
def test_an_answer_that_is_seconds_late_is_still_of_use(tea_box, shoot, path, looked_at) -> None:
    """Of the first frames in which it was carried about only every sixth is left, so not number 15."""
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
    assert tracker.reach_s is None, "it began less than four seconds ago"
    assert poses[0].state is State.TRACKING
    assert np.linalg.norm(poses[0].T_cam_obj[:3, 3] - path(number)[:3, 3]) < 2e-3
    assert se3.rotation_angle(poses[0].T_cam_obj, path(number)) < np.radians(1.0)
    assert tracker.correct(replace(correction, seq=2, stamp_ns=-1)) is Applied.REFUSED_OLD
