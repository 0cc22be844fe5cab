"""The solver: a step moves a pose as it says, rows are derivatives, and information is that of `perturb`."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.refine.solver import (
    Body,
    NormalEquations,
    add_residual,
    advance,
    clear,
    image_row,
    information,
    motion_row,
    motion_row_cam,
    move,
    normal_equations,
)

BODY = Body(np.array([0.02, -0.03, 0.05]), 0.07)
POSE = se3.make(se3.rotation_exp(np.array([0.4, -0.7, 1.1])), np.array([0.05, -0.02, 0.7]))
CAMERA = np.array([610.0, 590.0, 320.0, 240.0])
RNG = np.random.default_rng(0)
POINTS = RNG.normal(0.0, 0.05, (12, 3))


def moved(T: np.ndarray, step: np.ndarray) -> np.ndarray:
    out = T.copy()
    move(out, step, BODY)
    return out


def slopes(function) -> np.ndarray:
    """Central differences of a function of a step (6,)."""
    h = 1e-6 * np.eye(6)
    return np.array([(function(d) - function(-d)) / 2e-6 for d in h])


def test_a_step_shifts_and_rotates_about_the_centre_along_the_objects_axes() -> None:
    step = np.array([0.003, -0.002, 0.004, 0.01, -0.02, 0.005])
    turn = se3.rotation_exp(step[3:] / BODY.radius)
    there = se3.apply(POSE, (POINTS + step[:3] - BODY.centre) @ turn.T + BODY.centre)
    np.testing.assert_allclose(se3.apply(moved(POSE, step), POINTS), there, atol=1e-14)
    np.testing.assert_allclose(moved(POSE, np.zeros(6)), POSE, atol=1e-16)


def test_rows_are_derivatives_with_respect_to_the_step() -> None:
    g_obj, g_cam = np.array([0.6, -0.3, 0.9]), np.array([-0.2, 0.8, 0.5])
    gu, gv = 3.0, -1.5

    def pixel(T: np.ndarray, p: np.ndarray) -> float:
        x, y, z = se3.apply(T, p)
        return float(gu * CAMERA[0] * x / z + gv * CAMERA[1] * y / z)

    for p in POINTS[:4]:
        along = POSE[:3, :3] @ g_obj
        expected = slopes(lambda d, p=p, along=along: along @ se3.apply(moved(POSE, d), p))
        np.testing.assert_allclose(motion_row(*p, *g_obj, BODY), expected, atol=1e-8)
        expected = slopes(lambda d, p=p: g_cam @ se3.apply(moved(POSE, d), p))
        np.testing.assert_allclose(motion_row_cam(POSE, *p, *g_cam, BODY), expected, atol=1e-8)
        expected = slopes(lambda d, p=p: pixel(moved(POSE, d), p))
        np.testing.assert_allclose(image_row(POSE, *p, gu, gv, CAMERA, BODY), expected, atol=1e-4)


def test_information_is_that_of_perturb() -> None:
    """Of distances along directions: sum of weight * gradient gradient^T, by numeric differentiation."""
    directions, weights = RNG.normal(size=(12, 3)), RNG.uniform(0.5, 2.0, 12)
    equations, expected = normal_equations(6), np.zeros((6, 6))
    for p, g, w in zip(POINTS, directions, weights, strict=True):
        add_residual(equations, w, 0.0, motion_row_cam(POSE, *p, *g, BODY))
        slope = slopes(lambda d, p=p, g=g: g @ se3.apply(se3.perturb(POSE, d), p))
        expected += w * np.outer(slope, slope)
    np.testing.assert_allclose(information(equations.A, POSE, BODY), expected, rtol=1e-6, atol=1e-6)
    assert not np.triu(equations.A, 1).any()


def pulled(T: np.ndarray, targets: np.ndarray, equations: NormalEquations) -> None:
    """A factor: each point to its target, axis by axis of the camera."""
    for p, gap in zip(POINTS, targets - se3.apply(T, POINTS), strict=True):
        for axis, direction in enumerate(np.eye(3)):
            add_residual(equations, 1.0, gap[axis], motion_row_cam(T, *p, *direction, BODY))


def test_a_transform_is_recovered_exactly() -> None:
    targets, T, equations = se3.apply(POSE, POINTS), moved(POSE, RNG.normal(0, 0.03, 6)), normal_equations(6)
    for _ in range(12):
        clear(equations)
        pulled(T, targets, equations)
        largest = advance(T, equations, BODY, 0.0)
    assert 0.0 <= largest < 1e-9
    np.testing.assert_allclose(T, POSE, atol=1e-9)
    assert se3.is_rigid(T, 1e-9)


def test_strong_damping_holds_the_pose_and_an_unsolvable_system_leaves_it() -> None:
    targets, T, equations = se3.apply(POSE, POINTS) + 0.01, POSE.copy(), normal_equations(6)
    pulled(T, targets, equations)
    assert 0.0 < advance(T, equations, BODY, 1e6) < 1e-6
    clear(equations)
    equations.A[0, 0] = -1.0
    before = T.copy()
    assert advance(T, equations, BODY, 0.0) == -1.0
    np.testing.assert_array_equal(T, before)


def test_unknowns_beyond_the_pose_are_solved_with_it() -> None:
    """The points shifted and grew; the seventh unknown is the growth."""
    equations, T = normal_equations(7), np.eye(4)
    body = Body(np.zeros(3), 1.0)
    gaps = 0.01 * POINTS + [0.002, 0.0, -0.001]
    for p, gap in zip(POINTS, gaps, strict=True):
        for axis, direction in enumerate(np.eye(3)):
            add_residual(equations, 1.0, gap[axis], (*motion_row(*p, *direction, body), p[axis]))
    advance(T, equations, body, 0.0)
    np.testing.assert_allclose(equations.step, [0.002, 0, -0.001, 0, 0, 0, 0.01], atol=1e-9)
    np.testing.assert_allclose(T[:3, 3], [0.002, 0, -0.001], atol=1e-9)
