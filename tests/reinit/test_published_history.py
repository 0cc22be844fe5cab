"""Past poses: between two published ones, at the ends, and after an object is forgotten."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.reinit.published_history import PublishedHistory
from huepose.tracking.types import TrackedPose

ORIGIN = np.zeros(3)


def published(stamp_ns: int, x: float | None, covariance: Float64 | None = None) -> TrackedPose:
    T = None if x is None else se3.make(np.eye(3), np.array([x, 0.0, 1.0]))
    return TrackedPose("can", 0, 1, 0, stamp_ns, State.TRACKING, T, None, 0.9, covariance, 0)


def test_a_pose_between_two_is_interpolated_and_less_certain() -> None:
    past, small = PublishedHistory(), np.eye(6) * 1e-8
    past.note(published(0, 0.0, small))
    newest = published(100_000_000, 0.1, small)
    between = past.at(newest, 25_000_000, ORIGIN)
    assert between.T_cam_obj[0, 3] == pytest.approx(0.025)
    assert between.stamp_ns == 25_000_000
    assert between.covariance is not None
    assert (np.diag(between.covariance) > 1e-8).all()
    assert past.at(newest, -5, ORIGIN).T_cam_obj[0, 3] == 0.0
    assert past.at(newest, 900_000_000, ORIGIN).T_cam_obj[0, 3] == 0.1


def test_missing_and_old_poses_are_not_remembered() -> None:
    past = PublishedHistory()
    for track in (published(10, 0.1), published(10, 0.2), published(5, 0.3), published(20, None)):
        past.note(track)
    assert past.at(published(30, 0.4), 9, ORIGIN).T_cam_obj[0, 3] == 0.1
    for n in range(3):
        past.note(published(100 + n * 5_000_000_000, 0.5))
    assert past.at(published(11_000_000_000, 0.4), 9, ORIGIN).stamp_ns == 100, "ten seconds are remembered"
    past.note(published(10_000_000_101, 0.5))
    assert past.at(published(11_000_000_000, 0.4), 9, ORIGIN).stamp_ns == 5_000_000_100
    past.forget("can")
    assert past.at(published(300, 0.4), 9, ORIGIN).stamp_ns == 300
    with pytest.raises(ValueError, match="no pose"):
        past.at(published(300, None), 9, ORIGIN)


def test_across_a_loss_nothing_is_interpolated() -> None:
    past = PublishedHistory()
    for stamp_ns, x in ((0, 0.0), (100, 0.1), (200, None), (300, None), (400, 0.8)):
        past.note(published(stamp_ns, x))
    newest = published(500, 0.9)
    places = [past.at(newest, stamp_ns, ORIGIN).T_cam_obj[0, 3] for stamp_ns in (50, 150, 250, 399, 450)]
    assert places == pytest.approx([0.05, 0.1, 0.8, 0.8, 0.85])


def test_interpolation_rotates_about_the_middle_however_far_the_origin_is() -> None:
    past, middle = PublishedHistory(), np.array([2.0, -1.0, 0.5])

    def turned(stamp_ns: int, angle: float) -> TrackedPose:
        R = se3.rotation_exp(np.array([0.2, angle, 0.0]))
        T = se3.make(R, np.array([0.0, 0.0, 1.0]) - R @ middle)
        return TrackedPose("can", 0, 1, 0, stamp_ns, State.TRACKING, T, None, 0.9, np.eye(6) * 1e-8, 0)

    past.note(turned(0, 0.0))
    between = past.at(turned(100_000_000, 0.5), 50_000_000, middle)
    np.testing.assert_allclose(se3.apply(between.T_cam_obj, middle[None])[0], [0.0, 0.0, 1.0], atol=1e-12)
    to_middle = se3.carrying(turned(0, 0.0).T_cam_obj[:3, :3] @ middle)
    sure = np.sqrt(np.diag(to_middle @ between.covariance @ to_middle.T))
    assert sure[:3].max() < 0.006, "5 mm in 50 ms"
