"""Where a camera is on a robot, from poses of the hand and poses of one object (hand-eye calibration).

With A_i X B_i = Y for all i: a closed form (`hand_eye_methods`) finds X from the moves between measurements,
then X and Y are refined together over all measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.hand_eye_methods import CLOSED_FORMS, Method, disagreement, rotation_vectors
from huepose.support.errors import InputError
from huepose.support.words import counted

FEWEST = 4
"""Measurements: three moves are the fewest whose rotations also show how well they agree."""

LEAST_SPREAD_RAD = np.radians(10.0)
"""How far the moves have to turn about a second axis: under that, a degree of error in a pose becomes
several centimetres in the answer."""

MOST_STEPS = 50
"""Of the refinement: measurements that belong together need under ten, others never end."""


@dataclass(frozen=True, eq=False)
class HandEye:
    """X and Y (4, 4); what is left of each measurement, shift in metres (N,) and turn in radians (N,);
    forms_apart: how far the closed forms lie apart, metres and radians."""

    X: Float64
    Y: Float64
    shift_m: Float64
    turn_rad: Float64
    forms_apart: tuple[float, float]


def solve(A: Float64, B: Float64, method: Method = "park") -> HandEye:
    """X and Y of A_i X B_i = Y, A and B (N, 4, 4). method: the closed form from which it is refined.

    A camera on the hand that looks at an object which stands still: A = T_base_hand, B = T_cam_obj; X is
    T_hand_cam, Y is T_base_obj. A camera that is fixed and looks at an object in the hand: A = T_hand_base;
    X is T_base_cam, Y is T_hand_obj. Raises InputError for too few measurements, or moves about one axis."""
    A, B = np.asarray(A, np.float64), np.asarray(B, np.float64)
    if len(A) < FEWEST:
        raise InputError(
            "hand-eye calibration",
            found=counted(len(A), "measurement"),
            expected=f"{FEWEST} or more, better twelve, with the hand turned about different axes",
        )
    M, alpha = moves(A)  # M X = X N
    N, _ = moves(np.array([se3.inverse(b) for b in B]))
    most, spread = np.linalg.svd(alpha, compute_uv=False)[:2] / np.sqrt(len(alpha))
    if spread < LEAST_SPREAD_RAD:
        raise InputError(
            "hand-eye calibration",
            found=f"next to no turns of the hand ({np.degrees(most):.1f} degrees)"
            if most < LEAST_SPREAD_RAD
            else f"turns about one axis alone ({np.degrees(spread):.1f} degrees about any other)",
            expected="the hand turned about two axes or more, by 20 degrees or more",
        )
    X = CLOSED_FORMS[method](M, N)
    return _refined(A, B, X, A[0] @ X @ B[0], disagreement(M, N))


def moves(A: Float64) -> tuple[Float64, Float64]:
    """From each pose to each later one, A_n^-1 A_m (K, 4, 4), and their rotation vectors (K, 3), radians."""
    i, j = np.triu_indices(len(A), 1)
    between = np.array([se3.inverse(T) for T in A])[j] @ A[i]
    return between, rotation_vectors(between)


def _refined(A: Float64, B: Float64, X: Float64, Y: Float64, forms_apart: tuple[float, float]) -> HandEye:
    """Least squares over all measurements; a radian counts as much as the distance at which it is seen."""
    lever_m = lever(B)

    def left(steps: Float64) -> Float64:
        return residuals(A, B, X @ se3.exp(steps[:6]), Y @ se3.exp(steps[6:]), lever_m)

    found = least_squares(left, np.zeros(12), loss="soft_l1", f_scale=0.01, max_nfev=MOST_STEPS)
    rest = left(found.x).reshape(2, -1, 3)
    shift_m, turn_rad = np.linalg.norm(rest[0], axis=1), np.linalg.norm(rest[1], axis=1) / lever_m
    return HandEye(X @ se3.exp(found.x[:6]), Y @ se3.exp(found.x[6:]), shift_m, turn_rad, forms_apart)


def lever(B: Float64) -> float:
    """The distance in metres at which the object is seen: a turn of an error moves it by so much."""
    return float(np.median(np.linalg.norm(B[:, :3, 3], axis=1)))


def residuals(A: Float64, B: Float64, X: Float64, Y: Float64, lever_m: float) -> Float64:
    """What X and Y leave of each measurement in metres, all shifts (3N,), then all turns times the lever
    (3N,)."""
    left = se3.inverse(Y) @ A @ X @ B
    turns = rotation_vectors(left)
    return np.concatenate([left[:, :3, 3].ravel(), lever_m * turns.ravel()])
