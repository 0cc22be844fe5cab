"""A leap is not believed at once, and a pose says itself how far off it may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.tracking import Correction, State, Tracker, TrackerConfig
from huepose.tracking import track as one_track
from huepose.tracking.evidence import ONE_SENSE, vouched
from huepose.tracking.second_thought import leapt
from huepose.tracking.surface import TrackedSurface
from huepose.tracking.uncertainty import spread_m

FLIP = se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
FRAME_S = 1.0 / 30.0


def test_the_spread_of_a_turn_grows_with_the_distance_from_the_axis() -> None:
    covariance = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 0.1**2])
    points = np.array([[0.05, 0.0, 7.0], [0.0, -0.05, 0.0]], np.float32)
    assert spread_m(covariance, np.eye(4), points) == pytest.approx(0.005)
    assert spread_m(np.diag([4e-6, 0, 0, 0, 0, 0]), np.eye(4), points) == pytest.approx(0.002)


def test_the_spread_is_that_of_poses_drawn_from_the_covariance() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(0.0, 0.01, (6, 6))
    covariance = root @ root.T
    T = se3.make(se3.rotation_exp(np.array([0.4, -1.0, 0.3])), np.array([0.1, 0.2, 0.7]))
    points = rng.uniform(-0.05, 0.05, (20, 3)).astype(np.float32)
    moved = [se3.perturb(T, delta) for delta in rng.multivariate_normal(np.zeros(6), covariance, 4000)]
    squares = [((se3.apply(M, points) - se3.apply(T, points)) ** 2).sum(1).mean() for M in moved]
    assert spread_m(covariance, T, points) == pytest.approx(np.sqrt(np.mean(squares)), rel=0.03)


def test_a_quality_is_no_better_than_what_the_covariance_vouches_for() -> None:
    assert vouched(0.99, 0.01) == pytest.approx(0.99)
    assert vouched(1.0, 0.1) == pytest.approx(0.6827, abs=1e-4)
    assert vouched(1.0, 1.0) == ONE_SENSE
    assert vouched(0.1, 1.0) == 0.1


def test_only_what_no_hand_turns_and_what_shows_is_a_leap(tea_box) -> None:
    surface, config, T = TrackedSurface.of(tea_box), TrackerConfig(), np.eye(4)

    def turned(degrees):
        return se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.radians(degrees)])), np.zeros(3))

    assert not leapt(surface, T, turned(15.0), FRAME_S, config)
    assert leapt(surface, T, turned(40.0), FRAME_S, config)
    assert not leapt(surface, T, turned(40.0), 5.0 * FRAME_S, config), "there was time for it"


@pytest.mark.parametrize("right", [True, False])
def test_after_a_leap_the_image_decides_between_the_two(tea_box, shoot, path, right, monkeypatch) -> None:
    frames = [shoot([(tea_box.mesh, path(k))], k) for k in range(12)]
    tracker = Tracker({"tea_box": tea_box})
    begin = path(0) if not right else path(0) @ FLIP
    tracker.correct(Correction.first("tea_box", path(0), frames[0]))
    for frame in frames[:4]:
        tracker.step(frame)
    track = tracker._tracks["tea_box", 0]
    # One step of the real tracker is made to end on another side of the box, or to begin on one.
    if right:
        track.T_cam_obj = track.T_cam_obj @ se3.inverse(path(0)) @ begin
        landing = path(4)
    else:
        landing = path(4) @ FLIP
    real = one_track.advance

    def leap(*arguments):
        return replace(real(*arguments), T_cam_obj=landing)

    with monkeypatch.context() as patch:
        patch.setattr(one_track, "advance", leap)
        (pose,) = tracker.step(frames[4])
    assert pose.state is State.SUSPECT
    poses = [tracker.step(frame)[0] for frame in frames[5:]]
    assert poses[-1].state is State.TRACKING
    assert np.linalg.norm(poses[-1].T_cam_obj[:3, 3] - path(11)[:3, 3]) < 0.002
    assert se3.rotation_angle(poses[-1].T_cam_obj, path(11)) < np.radians(1.0)
