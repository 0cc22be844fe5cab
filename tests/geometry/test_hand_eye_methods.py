"""The closed forms of hand-eye calibration: known answers, and those of another implementation with noise."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.geometry.hand_eye import CLOSED_FORMS, disagreement, moves, solve

X = se3.make(se3.rotation_exp(np.array([0.3, -0.7, 0.4])), np.array([0.4, -0.2, 0.9]))
Y = se3.make(se3.rotation_exp(np.array([-1.2, 0.2, 0.5])), np.array([0.02, 0.05, 0.12]))

OPENCV: dict[str, tuple[list[float], list[float]]] = {
    "park": ([0.40028, -0.199293, 0.901662], [0.299435, -0.701252, 0.403157]),
    "tsai": ([0.400216, -0.199329, 0.90169], [0.299425, -0.701332, 0.403064]),
    "daniilidis": ([0.400222, -0.199677, 0.901502], [0.30055, -0.701325, 0.403747]),
}
"""X of `noisy()` by cv2.calibrateHandEye of OpenCV 4.12: translation, rotation vector."""


def measured(X: np.ndarray, count: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """A and B of measurements without errors and without random numbers."""
    turns = [np.array([np.sin(k), np.cos(2.0 * k), np.sin(3.0 * k + 1.0)]) for k in range(count)]
    A = np.array([se3.make(se3.rotation_exp(0.6 * w), 0.2 * w[::-1]) for w in turns])
    return A, np.array([se3.inverse(a @ X) @ Y for a in A])


def noisy() -> tuple[np.ndarray, np.ndarray]:
    """The same with errors of some millimetres and tenths of a degree."""
    A, B = measured(X, 8)
    errors = [0.003 * np.sin(np.arange(1.0, 7.0) * (k + 1.0)) for k in range(len(B))]
    return A, np.array([se3.perturb(b, e) for b, e in zip(B, errors, strict=True)])


def of_moves(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return moves(A)[0], moves(np.array([se3.inverse(b) for b in B]))[0]


@pytest.mark.parametrize("method", CLOSED_FORMS)
@pytest.mark.parametrize("angle", [0.0, 0.5, 2.5, np.pi - 1e-9, np.pi])
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.48, 0.6, -0.64)])
def test_without_noise_each_is_exact_however_the_camera_is_rotated(
    method: str, angle: float, axis: tuple[float, float, float]
) -> None:
    true = se3.make(se3.rotation_exp(angle * np.array(axis)), X[:3, 3])
    found = CLOSED_FORMS[method](*of_moves(*measured(true)))
    np.testing.assert_allclose(found, true, atol=1e-6)


@pytest.mark.parametrize("method", CLOSED_FORMS)
def test_with_noise_each_gives_the_answer_of_opencv_4(method: str) -> None:
    found = CLOSED_FORMS[method](*of_moves(*noisy()))
    translation, turn = OPENCV[method]
    np.testing.assert_allclose(found[:3, 3], translation, atol=2e-6)
    np.testing.assert_allclose(se3.rotation_log(found[:3, :3]), turn, atol=2e-6)


@pytest.mark.parametrize("method", CLOSED_FORMS)
def test_the_refined_answer_does_not_depend_on_the_start(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = solve(*noisy())
    monkeypatch.setattr("huepose.geometry.hand_eye.park", CLOSED_FORMS[method])
    other = solve(*noisy())
    np.testing.assert_allclose(one.X, other.X, atol=1e-5)


def test_the_disagreement_is_the_largest_distance() -> None:
    shift_m, turn_rad = disagreement(*of_moves(*noisy()))
    places = np.array([translation for translation, _ in OPENCV.values()])
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    assert shift_m == pytest.approx(apart.max(), abs=5e-6)
    assert 0.0 < turn_rad < np.radians(1.0)
    shift_m, turn_rad = disagreement(*of_moves(*measured(X)))
    assert shift_m < 1e-9
    assert turn_rad < 1e-7
