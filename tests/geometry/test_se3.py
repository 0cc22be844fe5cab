import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from huepose.geometry import se3

unit = st.floats(-1, 1, allow_nan=False)
twists = st.tuples(*[unit] * 6).map(lambda x: np.array(x) * [2, 2, 2, 1.7, 1.7, 1.7])


@given(twists)
def test_log_undoes_exp(twist):
    np.testing.assert_allclose(se3.log(se3.exp(twist)), twist, atol=1e-7)


@given(twists, twists)
def test_compose_with_inverse_is_identity(a, b):
    T = se3.compose(se3.exp(a), se3.exp(b))
    np.testing.assert_allclose(se3.compose(T, se3.inverse(T)), np.eye(4), atol=1e-9)
    assert se3.is_rigid(T)


@given(twists)
def test_quaternion_round_trip(twist):
    R = se3.exp(twist)[:3, :3]
    np.testing.assert_allclose(se3.rotation_from_quaternion(se3.quaternion_from_rotation(R)), R, atol=1e-9)


@given(twists, twists)
def test_difference_undoes_perturb(a, delta):
    T = se3.exp(a)
    np.testing.assert_allclose(se3.difference(T, se3.perturb(T, delta)), delta, atol=1e-7)


@pytest.mark.parametrize("axis", np.eye(3))
def test_rotation_log_is_exact_at_half_a_turn(axis):
    assert np.linalg.norm(se3.rotation_log(se3.rotation_exp(axis * np.pi))) == pytest.approx(np.pi, abs=1e-9)


def test_quarter_turn_about_z_takes_x_to_y():
    R = se3.rotation_exp(np.array([0, 0, np.pi / 2]))
    np.testing.assert_allclose(R @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(
        se3.quaternion_from_rotation(R), [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12
    )


def test_interpolation_halfway():
    T = se3.interpolate(
        np.eye(4), se3.make(se3.rotation_exp(np.array([0, 0, 1.0])), np.array([2.0, 0, 0])), 0.5
    )
    np.testing.assert_allclose(se3.rotation_log(T[:3, :3]), [0, 0, 0.5], atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], [1, 0, 0])


def test_interpolation_moves_the_given_point_on_a_straight_line():
    T_0, T_1 = (
        se3.exp(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])),
        se3.exp(np.array([0.3, 0.1, 0, -0.4, 0.2, 0])),
    )
    point = np.array([3.0, -1.0, 2.0])
    T = se3.interpolate(T_0, T_1, 0.3, point)
    np.testing.assert_allclose(T[:3, :3], se3.interpolate(T_0, T_1, 0.3)[:3, :3])
    np.testing.assert_allclose(se3.apply(T, point), 0.7 * se3.apply(T_0, point) + 0.3 * se3.apply(T_1, point))
    np.testing.assert_allclose(se3.interpolate(T_0, T_1, 1.0, point), T_1, atol=1e-12)


def test_a_reflection_is_not_rigid_and_is_repaired():
    T = np.diag([1.0, 1.0, -1.0, 1.0])
    assert not se3.is_rigid(T)
    assert se3.is_rigid(se3.orthonormalised(T))
    assert not se3.is_rigid(np.full((4, 4), np.nan))
