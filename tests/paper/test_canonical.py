"""Canonical features: known frames, invariance to direction and scale, and the inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from huepose.geometry import se3
from huepose.paper.canonical import FEATURES, canonical, centroid, look_at
from huepose.paper.relative_pose import LiftedMatches
from huepose.paper.rotation_network import regressed, translation_given

places = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(0.3, 1.5)).map(np.array)
turns = st.tuples(*[st.floats(-0.9, 0.9)] * 3).map(np.array)


@pytest.fixture(scope="module")
def cloud() -> np.ndarray:
    """Points (40, 3) about the origin, metres."""
    points = np.random.default_rng(3).normal(0.0, 0.03, (40, 3))
    return points - points.mean(0)


def test_the_look_at_frame_of_the_paper() -> None:
    np.testing.assert_allclose(look_at(np.array([0, 0, 0.7])), np.diag([-1.0, -1.0, 1.0]), atol=1e-15)
    R = look_at(np.array([0.3, -0.2, 0.8]))
    z = np.array([0.3, -0.2, 0.8]) / np.linalg.norm([0.3, -0.2, 0.8])
    x = np.cross([0.0, -1.0, 0.0], z)
    np.testing.assert_allclose(R[:, 0], x / np.linalg.norm(x))
    np.testing.assert_allclose(R[:, 1], np.cross(z, R[:, 0]))
    np.testing.assert_allclose(R[:, 2], z)
    with pytest.raises(ValueError, match="line of sight"):
        look_at(np.zeros(3))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_line_of_sight_along_the_up_vector_has_the_limit_frame(side: float) -> None:
    there, near = look_at(np.array([0.0, side, 0.0])), look_at(np.array([0.0, side, 1e-6]))
    assert se3.is_rigid(se3.make(there, np.zeros(3)))
    np.testing.assert_allclose(there, near, atol=1e-5)


@settings(max_examples=40, deadline=None)
@given(places, places, turns, st.floats(0.3, 4.0))
def test_features_do_not_depend_on_direction_and_scale(cloud, here, there, turn, size) -> None:
    """The same two views of an object in another direction at the same distance, and everything scaled."""
    there_b = there / np.linalg.norm(there) * np.linalg.norm(here) * 1.1
    there = there / np.linalg.norm(there) * np.linalg.norm(here)
    seen_a, seen_b = cloud, cloud @ se3.rotation_exp(turn).T
    here_b = 1.1 * here
    first = canonical(seen_a @ look_at(here).T + here, seen_b @ look_at(here_b).T + here_b)
    other = canonical(
        size * (seen_a @ look_at(there).T + there), size * (seen_b @ look_at(there_b).T + there_b)
    )
    assert first.features.shape == (len(cloud), FEATURES)
    np.testing.assert_allclose(other.features, first.features, atol=2e-5)
    assert other.size_m == pytest.approx(size * first.size_m)


@settings(max_examples=40, deadline=None)
@given(places, turns, places)
def test_a_rotation_is_converted_to_the_canonical_frame_and_back(cloud, place, turn, end) -> None:
    R_b_a = se3.rotation_exp(turn)
    a = cloud + place
    seen = canonical(a, cloud @ R_b_a.T + end)
    R_canon = seen.canonical_rotation(R_b_a)
    np.testing.assert_allclose(seen.rotation(R_canon), R_b_a, atol=1e-12)
    f = seen.features.astype(np.float64)
    np.testing.assert_allclose(f[:, 3:6], f[:, :3] @ R_canon.T, atol=1e-5)
    np.testing.assert_allclose(f[:, 10:13], f[:, 3:6] - f[:, :3], atol=1e-6)
    np.testing.assert_allclose(f[:, 13:15], f[:, 8:10] - f[:, 6:8], atol=1e-6)
    d = np.linalg.norm(place) / seen.size_m
    np.testing.assert_allclose(f[:, 6:8], f[:, :2] / (1.0 + f[:, 2:3] / d), atol=1e-5)


def test_outlier_matches_do_not_move_the_centroid(cloud) -> None:
    spoiled = np.concatenate([cloud, [[0.0, 0.0, 3.0]]])
    np.testing.assert_allclose(centroid(spoiled), cloud.mean(0), atol=1e-9)
    weights = np.concatenate([np.ones(40), [0.0]])
    np.testing.assert_allclose(centroid(spoiled, weights), cloud.mean(0), atol=1e-9)


def test_features_need_three_different_matches(cloud) -> None:
    with pytest.raises(ValueError, match="three"):
        canonical(cloud[:2], cloud[:2])
    with pytest.raises(ValueError, match="coincide"):
        canonical(np.ones((5, 3)), np.ones((5, 3)))


def test_the_translation_is_robust_to_wrong_matches(cloud) -> None:
    R, t = se3.rotation_exp(np.array([0.2, -0.3, 0.1])), np.array([0.03, -0.01, 0.02])
    a = cloud + np.array([0.1, 0.0, 0.6])
    b = a @ R.T + t
    b[:16] += np.random.default_rng(1).uniform(0.02, 0.2, (16, 3))
    np.testing.assert_allclose(translation_given(R, a, b, np.ones(40), 0.006), t, atol=1e-9)


def test_the_true_rotation_gives_the_true_motion(cloud) -> None:
    T = se3.make(se3.rotation_exp(np.array([0.3, 0.4, -0.2])), np.array([0.05, 0.02, -0.04]))
    a = cloud + np.array([0.2, -0.1, 0.7])
    b = se3.apply(T, a)
    weights = np.ones(len(a))
    R_canon = canonical(a, b, weights).canonical_rotation(T[:3, :3])

    def knows(features: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return R_canon

    motion = regressed("direct", knows, LiftedMatches(a, b, weights))
    assert motion is not None
    np.testing.assert_allclose(motion, T, atol=1e-9)
    assert regressed("direct", knows, LiftedMatches(a[:5], b[:5], weights[:5])) is None


def test_the_residual_rotation_is_added_to_the_closed_form(cloud) -> None:
    T = se3.make(se3.rotation_exp(np.array([0.1, 0.2, -0.1])), np.array([0.01, 0.02, -0.01]))
    a = cloud + np.array([0.1, -0.1, 0.6])
    b = se3.apply(T, a)
    matches = LiftedMatches(a, b, np.ones(len(a)))

    def turned_by(angle_rad: float) -> np.ndarray | None:
        R = se3.rotation_exp(np.array([0.0, 0.0, angle_rad]))
        return regressed("residual", lambda *seen: R, matches)

    same, turned = turned_by(0.0), turned_by(0.02)
    assert same is not None
    assert turned is not None
    np.testing.assert_allclose(same[:3, :3] @ T[:3, :3].T, np.eye(3), atol=2e-3)
    assert se3.rotation_angle(turned, same) == pytest.approx(0.02, abs=2e-3)
