"""Velocities, and the replay of corrections, are exact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame, se3
from huepose.judge.open_region import PreparedSurface
from huepose.model import ReferenceModel
from huepose.tracking.history import FrameHistory, PoseHistory
from huepose.tracking.motion import about_origin, filtered, increment_velocity, predicted, same_motion
from huepose.tracking.subject import Subject

TWIST = np.array([0.2, -0.1, 0.05, 0.8, -1.5, 0.4])
START = se3.make(se3.rotation_exp(np.array([0.3, 0.2, -0.5])), np.array([0.1, 0.0, 0.6]))


CENTRES = [[0.0, 0.0, 0.0], [0.02, -0.01, 0.05], [30.0, -28.0, 10.0]]


def moving(seconds: float) -> np.ndarray:
    """Constant velocity in the convention of `se3.perturb`."""
    return se3.perturb(START, TWIST * seconds)


def moving_about(centre_obj: list[float], seconds: float) -> np.ndarray:
    """The same motion of an object with this centre."""
    return moving(seconds) @ se3.make(np.eye(3), -np.array(centre_obj))


@pytest.fixture
def surface_of(tea_box: ReferenceModel) -> Callable[[list[float]], PreparedSurface]:
    """A function of a centre (3,): the surface with that centre."""
    surface = Subject.of(tea_box).surface
    return lambda centre: replace(surface, arrays=surface.arrays._replace(centre=np.array(centre)))


@pytest.mark.parametrize("centre", CENTRES)
def test_velocity_of_constant_motion_is_exact_wherever_the_origin_is(surface_of, centre) -> None:
    surface, velocity = surface_of(centre), None
    for k in range(1, 10):
        a, b = moving_about(centre, (k - 1) / 30), moving_about(centre, k / 30)
        velocity = filtered(velocity, increment_velocity(surface, a, b, 1 / 30), 1 / 30)
        np.testing.assert_allclose(velocity, TWIST, atol=1e-9)


@pytest.mark.parametrize("centre", CENTRES)
def test_prediction_of_constant_motion_is_exact_wherever_the_origin_is(surface_of, centre) -> None:
    surface, now = surface_of(centre), moving_about(centre, 0.02)
    velocity = increment_velocity(surface, moving_about(centre, 0.0), now, 0.02)
    ahead = predicted(surface, now, velocity, 0.1)
    np.testing.assert_allclose(ahead, moving_about(centre, 0.12), atol=1e-11)


@pytest.mark.parametrize("centre", CENTRES)
def test_a_velocity_is_published_about_the_origin(surface_of, centre) -> None:
    """For a short time `se3.perturb` with it gives the motion of the object."""
    surface, now, moment_s = surface_of(centre), moving_about(centre, 0.02), 1e-6
    velocity = about_origin(surface, now, TWIST)
    went = se3.difference(now, moving_about(centre, 0.02 + moment_s)) / moment_s
    np.testing.assert_allclose(velocity, went, atol=1e-3)
    turned = now @ se3.make(se3.rotation_exp([0.0, 0.0, 3.0]), np.zeros(3))
    same = same_motion(surface, TWIST, now, turned)
    np.testing.assert_allclose(about_origin(surface, turned, same), velocity, atol=1e-9)


def test_an_old_velocity_is_not_used(surface_of) -> None:
    surface = surface_of(CENTRES[0])
    assert predicted(surface, START, TWIST, 4.3) is START
    assert predicted(surface, START, None, 0.03) is START
    np.testing.assert_array_equal(filtered(TWIST, 2 * TWIST, 4.3), 2 * TWIST)


def test_a_change_of_velocity_is_followed_within_few_frames() -> None:
    velocity = TWIST
    for _ in range(4):
        velocity = filtered(velocity, -TWIST, 1 / 30)
    np.testing.assert_allclose(velocity, -TWIST, atol=0.03 * np.abs(TWIST).max())


def history(count: int = 10, wrong: np.ndarray | None = None) -> PoseHistory:
    h = PoseHistory(np.zeros(3))
    for k in range(count):
        T = moving(k / 30)
        h.append(100 + k, k * 1000, T if wrong is None else T @ wrong)
    return h


def test_perfect_correction_of_the_past_gives_truth_and_increments_exactly() -> None:
    """With a constant error in the object frame the increments are right, so the corrected pose is the
    truth."""
    wrong = se3.make(se3.rotation_exp(np.array([0.0, 0.0, 0.4])), np.array([0.0, 0.003, 0.001]))
    for late in range(10):
        h = history(wrong=wrong)
        now = h.replay(late * 1000, moving(late / 30))
        np.testing.assert_allclose(now, moving(9 / 30), atol=1e-12)


def test_correction_is_carried_by_the_buffered_increments() -> None:
    rng = np.random.default_rng(0)
    h = PoseHistory(np.zeros(3))
    poses = [START]
    for _ in range(6):
        poses.append(se3.perturb(poses[-1], rng.normal(0, 0.02, 6)))
    for k, T in enumerate(poses):
        h.append(k, k, T)
    truth = se3.perturb(poses[2], rng.normal(0, 0.05, 6))
    increments = [poses[k + 1] @ se3.inverse(poses[k]) for k in range(2, 6)]
    expected = truth
    for increment in increments:
        expected = increment @ expected
    np.testing.assert_allclose(h.replay(2, truth), expected, atol=1e-12)
    kept = [e.T_cam_obj for e in h]
    np.testing.assert_array_equal(kept[1], poses[1])
    np.testing.assert_allclose(kept[2], truth, atol=1e-12)


def test_two_corrections_in_a_row_compose() -> None:
    h = history()
    h.replay(3000, moving(3 / 30) @ se3.make(np.eye(3), np.array([0.01, 0, 0])))
    np.testing.assert_allclose(h.replay(6000, moving(6 / 30)), moving(9 / 30), atol=1e-12)


def test_a_skipped_frame_is_interpolated_by_its_timestamp() -> None:
    h = PoseHistory(np.zeros(3))
    a, b = moving(0.0), se3.make(se3.rotation_exp(np.array([0, 0, 0.3])) @ START[:3, :3], START[:3, 3] + 0.03)
    h.append(0, 0, a)
    h.append(3, 300, b)
    T = h.at(100)
    assert T is not None
    np.testing.assert_allclose(T[:3, 3], a[:3, 3] + 0.01, atol=1e-12)
    assert se3.rotation_angle(a, T) == pytest.approx(0.1, abs=1e-9)
    np.testing.assert_allclose(h.replay(100, T), b, atol=1e-9)


def test_the_history_has_no_pose_outside_its_range_or_across_a_gap() -> None:
    h = history(5)
    assert h.at(-1) is None
    assert h.at(4001) is None
    h.append(105, 5000, None)
    assert h.at(4500) is None
    assert not h.unbroken_since(2000)
    with pytest.raises(ValueError, match="unbroken"):
        h.replay(2000, START)
    with pytest.raises(ValueError, match="not newer"):
        h.append(106, 5000, START)
    h.put(5000, START)
    np.testing.assert_array_equal(h.at(5000), START)


@pytest.mark.parametrize("centre", CENTRES)
def test_interpolation_rotates_about_the_centre_wherever_the_origin_is(centre) -> None:
    h = PoseHistory(np.array(centre))
    for k in (0, 3):
        h.append(k, k * 100, moving_about(centre, 0.04 * k))
    at = h.at(150)
    assert at is not None
    np.testing.assert_allclose(at, moving_about(centre, 0.06), atol=1e-10)


def frames_at(stamps_s) -> list[RgbdFrame]:
    camera = Camera(10, 10, 1.5, 1.5, 4, 4)
    color, depth = np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.float32)
    return [RgbdFrame(color, depth, camera, k, round(s * 1e9)) for k, s in enumerate(stamps_s)]


def test_histories_forget_the_oldest() -> None:
    h = PoseHistory(np.zeros(3))
    frames = FrameHistory(3)
    for k, frame in enumerate(frames_at(np.arange(6) * 1e-9)):
        h.append(k, k, START)
        frames.append(frame)
    h.forget_before(3)
    assert [e.frame_id for e in h] == [3, 4, 5]
    assert len(frames) == 3
    assert not frames.covers(2)
    assert frames.covers(3)
    assert frames.covers(99), "a future frame is not too old"
    assert [f.frame_id for f in frames.since(4)] == [4, 5]
    assert h.newest is not None
    assert h.newest.frame_id == 5


def test_fewer_of_the_older_frames_are_kept() -> None:
    frames = FrameHistory(20, 24)
    jitter = np.random.default_rng(1).uniform(-0.002, 0.002, 600)
    for frame in frames_at(np.arange(600) / 30 + jitter):
        frames.append(frame)
    ids = [f.frame_id for f in frames]
    assert len(frames) == len(ids) == 44
    assert ids[24:] == list(range(580, 600))
    # The oldest are 6 frames apart, the next ones 3.
    assert list(np.diff(ids)[:11]) == [6] * 11
    assert list(np.diff(ids)[12:22]) == [3] * 10
    assert max(np.diff(ids)) <= 8, "no gap is much wider where the spacing changes"
    oldest, newest = frames.oldest, frames.newest
    assert oldest is not None
    assert newest is not None
    assert 3.7 < (newest.stamp_ns - oldest.stamp_ns) * 1e-9 < 4.6
    frames.clear()
    assert len(frames) == 0
    assert frames.oldest is None
    assert frames.from_nearest(3) == []


def test_a_slow_camera_loses_no_frame_to_thinning() -> None:
    frames = FrameHistory(4, 4)
    for frame in frames_at(np.arange(8) / 2):
        frames.append(frame)
    assert [f.frame_id for f in frames] == list(range(8))


def test_the_nearest_kept_frame_comes_first() -> None:
    frames = FrameHistory(2, 4)
    for frame in frames_at(np.arange(12) / 10):
        frames.append(frame)
    assert [f.frame_id for f in frames] == [4, 6, 8, 9, 10, 11]
    assert [f.frame_id for f in frames.from_nearest(510_000_000)] == [6, 8, 9, 10, 11]
    assert [f.frame_id for f in frames.from_nearest(490_000_000)] == [4, 6, 8, 9, 10, 11]
    assert [f.frame_id for f in frames.from_nearest(900_000_000)] == [9, 10, 11]
