"""Errors of known motions, areas under curves in closed form, invariances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from huepose.evaluation import metrics
from huepose.geometry import se3

POINTS = np.random.default_rng(0).uniform(-0.1, 0.1, (400, 3))
small = st.floats(-0.5, 0.5)


@given(st.tuples(small, small, small))
def test_add_of_a_translation_is_its_length(t: tuple[float, float, float]) -> None:
    T_truth = se3.make(se3.rotation_exp([0.2, -1.0, 2.0]), [0.1, 0.2, 0.9])
    T_estimate = se3.make(T_truth[:3, :3], T_truth[:3, 3] + t)
    assert metrics.add(POINTS, T_estimate, T_truth) == pytest.approx(np.linalg.norm(t), abs=1e-12)


def test_add_of_a_rotation_is_the_mean_chord() -> None:
    angle = 0.7
    radius = np.linalg.norm(POINTS[:, :2], axis=1)
    T = se3.make(se3.rotation_exp([0, 0, angle]), [0, 0, 0])
    assert metrics.add(POINTS, T, np.eye(4)) == pytest.approx(2 * np.sin(angle / 2) * radius.mean())


def test_adds_of_a_symmetric_object_rotated_onto_itself_is_zero() -> None:
    square = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]) * 0.1
    quarter = se3.make(se3.rotation_exp([0, 0, np.pi / 2]), [0, 0, 0])
    T = se3.make(se3.rotation_exp([0.3, 0.4, 0.5]), [0, 0, 1])
    assert metrics.adds(square, T @ quarter, T) == pytest.approx(0, abs=1e-12)
    assert metrics.add(square, T @ quarter, T) == pytest.approx(0.1 * math.sqrt(2))


def test_adds_goes_from_points_of_the_truth_to_the_nearest_of_the_estimate() -> None:
    """An uneven cloud, for which the two directions differ. The expected value is by brute force."""
    rng = np.random.default_rng(3)
    points = np.concatenate([rng.normal(0, 0.02, (60, 3)), [[0.2, 0, 0], [0, 0.3, 0]]])
    T_truth = se3.make(se3.rotation_exp(rng.normal(size=3)), rng.normal(size=3))
    T_estimate = se3.perturb(T_truth, np.array([0.1, 0.03, 0, 0.4, 0.2, 0.1]))
    a, b = se3.apply(T_truth, points), se3.apply(T_estimate, points)
    distances = np.linalg.norm(a[:, None] - b[None], axis=2)
    assert metrics.adds(points, T_estimate, T_truth) == pytest.approx(distances.min(1).mean())
    assert distances.min(1).mean() != pytest.approx(distances.min(0).mean())


@settings(deadline=None)
@given(st.tuples(small, small, small), st.tuples(small, small, small))
def test_both_errors_are_invariant_to_rigid_motions_of_the_scene(w: tuple, t: tuple) -> None:
    T_world = se3.make(se3.rotation_exp(np.array(w)), np.array(t))
    T_a, T_b = se3.exp(np.array([0.1, 0, 0.2, 0.3, 0.1, 0])), se3.exp(np.array([0.12, 0, 0.2, 0.1, 0.4, 0]))
    for error in (metrics.add, metrics.adds):
        assert error(POINTS, T_world @ T_a, T_world @ T_b) == pytest.approx(error(POINTS, T_a, T_b))


def test_recall_is_strict_and_counts_missing_poses_as_wrong() -> None:
    errors_m, diameters_m = np.array([0.049, 0.05, 0.051, np.inf]), np.full(4, 0.5)
    scores = metrics.pose_scores(errors_m, errors_m, diameters_m)
    assert scores["recall_add"].mean() == scores["recall_adds"].mean() == 25.0


def auc(errors_m) -> float:
    return metrics.pose_scores(errors_m, errors_m, np.ones(len(errors_m)))["auc_add"].mean()


def test_auc_is_linear_in_the_error() -> None:
    assert auc([0.0, 0.05, 0.1, 0.3, np.inf]) == pytest.approx(100 * (1 + 0.5) / 5)


def test_auc_is_the_area_under_the_accuracy_curve() -> None:
    errors = np.random.default_rng(1).exponential(0.04, 300)
    thresholds = (np.arange(20000) + 0.5) / 20000 * 0.1
    assert auc(errors) == pytest.approx(metrics.accuracy_curve(errors, thresholds).mean(), abs=0.01)


def test_voc_auc_equals_a_hand_computed_value() -> None:
    # Steps: 0..0.02 at 1/4, 0.02..0.06 at 2/4, 0.06..0.1 at 2/4 (the accuracy of the last finite error).
    expected = 100 / 0.1 * (0.02 * 0.25 + 0.04 * 0.5 + 0.04 * 0.5)
    assert metrics.auc_voc([0.06, 0.2, 0.02, np.inf]) == pytest.approx(expected)
    assert metrics.auc_voc([0.0, 0.0]) == pytest.approx(100.0)
    assert metrics.auc_voc([0.2, np.inf]) == 0.0


def test_voc_auc_approaches_the_plain_auc_for_many_poses() -> None:
    errors = np.random.default_rng(2).exponential(0.03, 5000)
    assert 0 < metrics.auc_voc(errors) - auc(errors) < 0.05


def test_calibration_error_of_calibrated_and_of_overconfident_quality() -> None:
    rng = np.random.default_rng(0)
    quality = rng.uniform(0, 1, 40000)
    right = rng.uniform(0, 1, 40000) < quality
    assert metrics.expected_calibration_error(quality, right) < 0.01
    assert metrics.expected_calibration_error(np.full(50, 0.9), np.arange(50) % 2 == 0) == pytest.approx(0.4)
    assert metrics.expected_calibration_error(np.array([0.75]), np.array([True])) == pytest.approx(0.25)
    assert metrics.expected_calibration_error(np.empty(0), np.empty(0, bool)) is None


def test_calibration_bins_have_equal_counts() -> None:
    """Nine tenths of the poses at quality 0.5: bins of equal width would hide the wrong poses."""
    quality = np.concatenate([np.full(90, 0.5), np.full(10, 1.0)])
    right = np.concatenate([np.ones(45, bool), np.zeros(45, bool), np.ones(10, bool)])
    # Of ten bins of ten, four are all right at 0.5, one is half right, four all wrong; the last is exact.
    assert metrics.expected_calibration_error(quality, right) == pytest.approx(8 * 0.5 / 10)


def test_no_poses_give_no_figures() -> None:
    assert set(metrics.four_figures(np.empty(0), np.empty(0), np.empty(0)).values()) == {None}
