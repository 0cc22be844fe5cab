"""Up to three hypotheses, between which later frames decide; and the uncertainty that a pose claims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.geometry.se3 import carrying
from huepose.judge.open_region import PreparedSurface
from huepose.judge.terms import NOTHING
from huepose.tracking import Correction, Tracker, TrackerConfig
from huepose.tracking.belief import Belief
from huepose.tracking.evidence import MOST_LOOSE, ONE_SENSE, limited_by_covariance
from huepose.tracking.hypothesis import Hypothesis, distinct, same_pose, share_of_first
from huepose.tracking.motion import jump_odds
from huepose.tracking.subject import Subject
from huepose.tracking.track import Track
from huepose.tracking.types import Doubt
from huepose.tracking.uncertainty import spread_m, uncertainty

FLIP = se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
FRAME_S = 1.0 / 30.0


def test_the_spread_of_a_rotation_grows_with_the_distance_from_the_axis() -> None:
    covariance = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 0.1**2])
    points = np.array([[0.05, 0.0, 7.0], [0.0, -0.05, 0.0]], np.float32)
    assert spread_m(covariance, np.eye(4), points) == pytest.approx(0.005)
    assert spread_m(np.diag([4e-6, 0, 0, 0, 0, 0]), np.eye(4), points) == pytest.approx(0.002)


def test_the_spread_is_that_of_poses_sampled_from_the_covariance() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(0.0, 0.01, (6, 6))
    covariance = root @ root.T
    T = se3.make(se3.rotation_exp(np.array([0.4, -1.0, 0.3])), np.array([0.1, 0.2, 0.7]))
    points = rng.uniform(-0.05, 0.05, (20, 3)).astype(np.float32)
    moved = [se3.perturb(T, delta) for delta in rng.multivariate_normal(np.zeros(6), covariance, 4000)]
    squares = [((se3.apply(M, points) - se3.apply(T, points)) ** 2).sum(1).mean() for M in moved]
    assert spread_m(covariance, T, points) == pytest.approx(np.sqrt(np.mean(squares)), rel=0.03)


def test_the_covariance_limits_the_quality() -> None:
    assert limited_by_covariance(0.99, 0.01) == pytest.approx(0.99)
    assert limited_by_covariance(1.0, 0.1) == pytest.approx(0.6827, abs=1e-4)
    assert limited_by_covariance(1.0, 1.0) == ONE_SENSE
    assert limited_by_covariance(0.1, 1.0) == 0.1
    assert limited_by_covariance(1.0, 0.033) > 0.99
    assert limited_by_covariance(1.0, 0.034) == MOST_LOOSE < TrackerConfig().least_quality, (
        "right is less than three sigmas"
    )


def test_a_pose_is_less_certain_the_more_of_the_object_is_outside_of_the_image(tea_box) -> None:
    subject, known = Subject.of(tea_box), np.diag([1e8, 1e8, 1e8, 1e4, 1e4, 1e4])
    away = se3.make(np.eye(3), np.array([0.0, 0.0, 0.7]))
    spreads = []
    for outside in (0.0, 0.75, 1.0):
        h = Hypothesis(away, replace(NOTHING, outside=outside), known, "still")
        covariance, spread = uncertainty(subject, h)
        assert np.allclose(covariance, covariance.T)
        spreads.append(spread)
    assert spreads[1] == pytest.approx(2.0 * spreads[0])
    assert spreads[2] == pytest.approx(np.sqrt(20.0) * spreads[0])


def test_the_uncertainty_of_a_pose_does_not_depend_on_the_origin(tea_box) -> None:
    subject, off = Subject.of(tea_box), np.array([0.0, 5.0, 0.0])
    arrays = subject.surface.arrays
    far = arrays._replace(points=(arrays.points + off).astype(np.float32), centre=arrays.centre + off)
    T, known = se3.make(np.eye(3), np.array([0.0, 0.0, 0.7])), np.diag([1e8, 1e8, 1e8, 1e5, 1e5, 1e5])
    to_origin = carrying(off - subject.surface.centre_cam(np.eye(4)))  # the same motions about another point
    here = Hypothesis(T, NOTHING, known, "still")
    there = replace(
        here, T_cam_obj=T @ se3.make(np.eye(3), -off), information=to_origin.T @ known @ to_origin
    )
    moved = replace(subject, surface=replace(subject.surface, arrays=far), points=subject.points + off)
    assert uncertainty(moved, there)[1] == pytest.approx(uncertainty(subject, here)[1], rel=1e-3)


def test_an_object_that_leaves_the_image_is_tracked_but_not_believed_until_it_is_back(
    plain_box, shoot, path
) -> None:
    tracker, T = Tracker({"plain_box": plain_box}), path(0).copy()
    first = shoot([(plain_box.mesh, T)], 0)
    tracker.step(first)
    tracker.correct(Correction.first("plain_box", T, first, 1.0))
    middle, edge = T[0, 3], 160.0 / 420.0 * T[2, 3]
    outwards = np.linspace(middle, edge + 0.03, 30)
    said = []
    for number, x in enumerate(np.concatenate([outwards, outwards[::-1]]), 1):
        T[0, 3] = x
        (pose,) = tracker.step(shoot([(plain_box.mesh, T)], number))
        said.append((pose.state, tracker.doubt("plain_box", 0)))
    assert said[20] == said[-1] == (State.TRACKING, None)
    assert said[29] == (State.SUSPECT, Doubt.LOOSE)
    assert all(state is not State.LOST for state, _ in said)


def turned(degrees: float) -> np.ndarray:
    return se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.radians(degrees)])), np.zeros(3))


def hypothesis_at(T: np.ndarray, log_odds: float) -> Hypothesis:
    return Hypothesis(T, NOTHING, np.zeros((6, 6)), "still", log_odds=log_odds)


def test_a_rotation_faster_than_any_hand_costs_log_odds(tea_box) -> None:
    surface, config, T = PreparedSurface.of(tea_box), TrackerConfig(), np.eye(4)

    def odds(degrees: float, seconds: float) -> float:
        return jump_odds(surface, T, T, turned(degrees), seconds, config)

    assert odds(15.0, FRAME_S) == 0.0
    assert odds(40.0, FRAME_S) < -0.5
    assert odds(180.0, FRAME_S) == -4.0
    assert odds(40.0, 5.0 * FRAME_S) == 0.0, "there was time for it"


def test_equal_poses_are_merged_and_improbable_hypotheses_dropped(tea_box) -> None:
    subject = Subject.of(tea_box)
    best, twin, other = (
        hypothesis_at(turned(0), 3.0),
        hypothesis_at(turned(2), 2.9),
        hypothesis_at(turned(90), 1.0),
    )
    hopeless = hypothesis_at(turned(180), -2.0)
    assert same_pose(subject, best.T_cam_obj, twin.T_cam_obj)
    assert distinct(subject, [hopeless, twin, other, best]) == (best, other)
    assert len(distinct(subject, [hypothesis_at(turned(60 * k), 1.0) for k in range(6)])) == 3


def test_the_share_of_the_first_follows_the_log_odds(tea_box) -> None:
    subject, one = Subject.of(tea_box), hypothesis_at(turned(0), 2.0)
    assert share_of_first(subject, ()) == 0.0
    assert share_of_first(subject, (one,)) == 1.0
    assert share_of_first(subject, (one, hypothesis_at(turned(90), 2.0))) == pytest.approx(0.5)
    apart = (one, hypothesis_at(turned(90), 0.0))
    assert share_of_first(subject, apart) == pytest.approx(1 / (1 + np.exp(-2.0)))


def test_a_hypothesis_close_to_the_first_counts_for_it(tea_box) -> None:
    subject = Subject.of(tea_box)
    one, near, other = (
        hypothesis_at(turned(0), 2.0),
        hypothesis_at(turned(20), 2.0),
        hypothesis_at(turned(90), 2.0),
    )
    assert not same_pose(subject, one.T_cam_obj, near.T_cam_obj)
    assert share_of_first(subject, (one, near)) == pytest.approx(1.0)
    assert share_of_first(subject, (one, near, other)) == pytest.approx(2 / 3)
    assert share_of_first(subject, (other, one, near)) == pytest.approx(1 / 3)


def test_an_equivalent_rotation_is_no_other_pose(tea_box) -> None:
    alike = Subject.of(replace(tea_box, equivalents=np.stack([np.eye(4), turned(180)])))
    one, same, other = (
        hypothesis_at(turned(0), 2.0),
        hypothesis_at(turned(181), 1.9),
        hypothesis_at(turned(90), 1.8),
    )
    assert distinct(alike, [one, same, other]) == (one, other)
    assert distinct(Subject.of(tea_box), [one, same, other]) == (one, same, other)


def test_an_object_that_looks_the_same_from_all_sides_shows_no_new_view(tea_box, started) -> None:
    first = started._tracks["tea_box", 0].hypotheses[0]
    round_ = replace(tea_box, equivalents=np.stack([turned(5 * k) for k in range(72)]))
    for model, same in ((tea_box, False), (round_, True)):
        belief = Belief(Subject.of(model), TrackerConfig())
        seen = belief._view(first)
        belief.identity = replace(belief.identity, view=seen)
        again = belief._view(replace(first, T_cam_obj=first.T_cam_obj @ turned(60)))
        assert (again @ seen > np.cos(np.radians(5))) == same


@pytest.mark.parametrize("right", [True, False])
def test_the_image_decides_between_two_hypotheses(tea_box, shoot, path, right) -> None:
    """Two opposite orientations start equal; within a few frames only the right one is left."""
    frames = [shoot([(tea_box.mesh, path(k))], k) for k in range(12)]
    tracker = Tracker({"tea_box": tea_box})
    tracker.correct(Correction.first("tea_box", path(0), frames[0], 1.0))
    for frame in frames[:4]:
        tracker.step(frame)
    track = tracker._tracks["tea_box", 0]
    seen = track.hypotheses[0]
    flipped = replace(seen, T_cam_obj=seen.T_cam_obj @ FLIP)
    track.hypotheses = (seen, flipped) if right else (flipped, seen)
    poses = [tracker.step(frame)[0] for frame in frames[4:]]
    assert poses[-1].state is State.TRACKING
    assert np.linalg.norm(poses[-1].T_cam_obj[:3, 3] - path(11)[:3, 3]) < 0.002
    assert se3.rotation_angle(poses[-1].T_cam_obj, path(11)) < np.radians(1.0)
    assert len(track.hypotheses) == 1


def test_the_image_undoes_a_wrong_correction(tea_box, shoot, path) -> None:
    frames = [shoot([(tea_box.mesh, path(k))], k) for k in range(9)]
    tracker = Tracker({"tea_box": tea_box})
    tracker.correct(Correction.first("tea_box", path(0), frames[0], 1.0))
    for frame in frames[:5]:
        tracker.step(frame)
    tracker._tracks["tea_box", 0].replay(Correction.first("tea_box", path(3) @ FLIP, frames[3], 0.95))
    poses = [tracker.step(frame)[0] for frame in frames[5:]]
    assert se3.rotation_angle(poses[-1].T_cam_obj, path(8)) < np.radians(1.0)
    assert poses[-1].state is State.TRACKING, "the image shows that the other pose is wrong"


@pytest.mark.parametrize(
    ("fits", "apart_deg", "state"),
    [(0.9, 90, State.SUSPECT), (0.1, 90, State.TRACKING), (0.9, 2, State.TRACKING)],
)
def test_if_perception_and_tracker_disagree_neither_is_believed(
    tea_box, film, started, fits, apart_deg, state
) -> None:
    """If perception is sure of another pose that fits the image too, though less, neither is believed."""
    track = started._tracks["tea_box", 0]
    other = Track(track.subject, "tea_box", 0, TrackerConfig())
    other.hypotheses = (hypothesis_at(track.T_cam_obj @ turned(apart_deg), 2.0),)
    other.belief.evidence = fits
    track.contradict(other, 0.98)
    frames = film(8)[6:]
    assert started.step(frames[0])[0].state is state
    if state is State.SUSPECT:
        assert started.doubt("tea_box", 0) is Doubt.IDENTITY
        track.agree(Correction.first("tea_box", track.T_cam_obj, frames[0], 0.98))
        assert started.step(frames[1])[0].state is State.TRACKING
