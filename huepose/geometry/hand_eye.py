"""Hand-eye calibration: where a camera is on a robot, from poses of the hand and poses of one object.

The problem is A_i X B_i = Y for all measurements i. First a closed form solves M_k X = X N_k, where M_k and
N_k are the motions of the hand and of the camera between measurements. Then X and Y are refined together
over all measurements.

Park's closed form finds the rotation from rotation vectors, Tsai's from tangents of half angles; both then
find the translation by least squares. Daniilidis finds both at once from the screws of the motions. They
weigh errors differently, so if they disagree, the measurements determine the result badly. OpenCV 4 has the
three as `calibrateHandEye`; OpenCV 5 does not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.kabsch import fit
from huepose.support.errors import InputError
from huepose.support.words import counted

FEWEST = 4
"""Fewest measurements. Three independent motions are the fewest whose rotations also show how well they
agree."""

LEAST_SPREAD_RAD = np.radians(10.0)
"""Least RMS rotation of the motions about a second axis. Below it, an error of a degree in a pose becomes
an error of several centimetres in the result."""

MOST_TURN_RAD = np.radians(150.0)
"""Largest rotation of a motion that a closed form may use. With errors of some degrees, the axes that the
hand and the camera show for a half turn may be opposite."""

MOST_STEPS = 50
"""Most evaluations of the refinement. Measurements that fit together need fewer than ten; others never
converge."""


@dataclass(frozen=True, eq=False)
class HandEye:
    """X and Y (4, 4). shift_m, turn_rad (N,): residual of each measurement, translation in metres and
    rotation in radians. forms_apart: how much the closed forms differ, metres and radians."""

    X: Float64
    Y: Float64
    shift_m: Float64
    turn_rad: Float64
    forms_apart: tuple[float, float]


def solve(A: Float64, B: Float64) -> HandEye:
    """X and Y of A_i X B_i = Y, A and B (N, 4, 4).

    B is T_cam_obj. For a camera on the hand and a static object, A is T_base_hand, X is T_hand_cam, and Y is
    T_base_obj. For a fixed camera and an object in the hand, A is T_hand_base, X is T_base_cam, and Y is
    T_hand_obj. Raises InputError for too few measurements, numbers that are not finite, an object without
    positions, or rotations about one axis only, half turns left out."""
    A, B = np.asarray(A, np.float64), np.asarray(B, np.float64)
    if not (np.isfinite(A).all() and np.isfinite(B).all()):
        raise InputError("hand-eye calibration", found="numbers that are not finite", expected="poses (4, 4)")
    if len(A) < FEWEST:
        raise InputError(
            "hand-eye calibration",
            found=counted(len(A), "measurement"),
            expected=f"{FEWEST} or more, better twelve, with the hand rotated about different axes",
        )
    if lever(B) == 0.0:
        found = "an object in the centre of the camera"
        raise InputError("hand-eye calibration", found=found, expected="positions of the object, metres")
    M, alpha = moves(A)  # M X = X N
    N, _ = moves(np.array([se3.inverse(b) for b in B]))
    certain = np.linalg.norm(alpha, axis=1) < MOST_TURN_RAD
    most, spread = _spread(alpha)
    if min(spread, _spread(alpha[certain])[1]) < LEAST_SPREAD_RAD:
        found = f"rotations about one axis only ({np.degrees(spread):.1f} degrees about any other)"
        if most < LEAST_SPREAD_RAD:
            found = f"almost no rotation of the hand ({np.degrees(most):.1f} degrees)"
        elif spread >= LEAST_SPREAD_RAD:
            found = "rotations about one axis only, besides half turns"
        raise InputError(
            "hand-eye calibration",
            found=found,
            expected="the hand rotated about two axes or more, by 20 to 150 degrees",
        )
    M, N = M[certain], N[certain]
    X = park(M, N)
    return _refined(A, B, X, A[0] @ X @ B[0], disagreement(M, N))


def _spread(alpha: Float64) -> tuple[float, float]:
    """RMS rotation about the axis with the most and about the one with the second most, of rotation vectors
    (K, 3)."""
    squares = np.linalg.eigvalsh(alpha.T @ alpha / max(len(alpha), 1))
    return float(np.sqrt(max(squares[2], 0.0))), float(np.sqrt(max(squares[1], 0.0)))


def moves(A: Float64) -> tuple[Float64, Float64]:
    """Motions between all pairs of poses, A_n^-1 A_m with n after m (K, 4, 4), and their rotation vectors
    (K, 3), radians."""
    i, j = np.triu_indices(len(A), 1)
    between = np.array([se3.inverse(T) for T in A])[j] @ A[i]
    return between, rotation_vectors(between)


def _refined(A: Float64, B: Float64, X: Float64, Y: Float64, forms_apart: tuple[float, float]) -> HandEye:
    """Robust least squares over all measurements. Rotations are weighted by the distance of the object."""
    lever_m = lever(B)

    def left(steps: Float64) -> Float64:
        return residuals(A, B, X @ se3.exp(steps[:6]), Y @ se3.exp(steps[6:]), lever_m)

    found = least_squares(left, np.zeros(12), loss="soft_l1", f_scale=0.01, max_nfev=MOST_STEPS)
    rest = left(found.x).reshape(2, -1, 3)
    shift_m, turn_rad = np.linalg.norm(rest[0], axis=1), np.linalg.norm(rest[1], axis=1) / lever_m
    return HandEye(X @ se3.exp(found.x[:6]), Y @ se3.exp(found.x[6:]), shift_m, turn_rad, forms_apart)


def lever(B: Float64) -> float:
    """Median distance of the object from the camera, metres: it converts rotation errors into lengths."""
    return float(np.median(np.linalg.norm(B[:, :3, 3], axis=1)))


def residuals(A: Float64, B: Float64, X: Float64, Y: Float64, lever_m: float) -> Float64:
    """Residuals of all measurements in metres: all translations (3N,), then all rotations times the lever
    (3N,)."""
    left = se3.inverse(Y) @ A @ X @ B
    turns = rotation_vectors(left)
    return np.concatenate([left[:, :3, 3].ravel(), lever_m * turns.ravel()])


def park(M: Float64, N: Float64) -> Float64:
    """X (4, 4) from motions (K, 4, 4): X rotates the rotation vectors of N onto those of M.

    Park and Martin, Robot sensor calibration: solving AX = XB on the Euclidean group (1994)."""
    alpha, beta = rotation_vectors(M), rotation_vectors(N)
    # The negated vectors make both centroids zero, so that the fit is a pure rotation.
    R = fit(np.vstack([beta, -beta]), np.vstack([alpha, -alpha]))[:3, :3]
    return _with_translation(M, N, R)


def tsai(M: Float64, N: Float64) -> Float64:
    """X (4, 4) from motions (K, 4, 4), by modified Rodrigues vectors 2 sin(angle / 2) axis.

    Tsai and Lenz, A new technique for fully autonomous and efficient 3D robotics hand/eye calibration (1989).
    If X rotates by 180 degrees, the equations do not determine its axis. So they are also solved with N
    rotated by 180 degrees about each axis, as in Shuster's method of sequential rotations (Approximate
    algorithms for fast optimal attitude computation, 1978). The best determined of the four solutions is
    taken."""
    p = _modified(M)
    found = []
    for half in (np.eye(3), *(se3.rotation_exp(np.pi * axis) for axis in np.eye(3))):
        q = _modified(N) @ half.T
        left = np.vstack([se3.hat(a + b) for a, b in zip(p, q, strict=True)])
        tangent, _, _, singular = np.linalg.lstsq(left, (q - p).ravel(), rcond=None)
        found.append((float(singular[-1]), tangent, half))
    _, tangent, half = max(found, key=lambda one: one[0])
    length = float(np.linalg.norm(tangent))  # the tangent of half the angle
    R = np.eye(3) if length < 1e-12 else se3.rotation_exp(2.0 * np.arctan(length) * tangent / length)
    return _with_translation(M, N, R @ half)


def daniilidis(M: Float64, N: Float64) -> Float64:
    """X (4, 4) from motions (K, 4, 4), by unit dual quaternions: rotation and translation at once.

    Daniilidis, Hand-eye calibration using dual quaternions (1999), equations 31 to 35."""
    rows = []
    for m, n in zip(M, N, strict=True):
        (a, a_dual), (b, b_dual) = _screw(m), _screw(n)
        upper = np.column_stack([a - b, se3.hat(a + b)])
        rows.append(np.hstack([upper, np.zeros((3, 4))]))
        rows.append(np.hstack([np.column_stack([a_dual - b_dual, se3.hat(a_dual + b_dual)]), upper]))
    v7, v8 = np.linalg.svd(np.vstack(rows), full_matrices=False)[2][-2:]
    (u1, v1), (u2, v2) = (v7[:4], v7[4:]), (v8[:4], v8[4:])
    # X is s v7 + t v8 with a unit real part that is orthogonal to its dual part: s / t has two candidates.
    ratios = np.roots([u1 @ v1, u1 @ v2 + u2 @ v1, u2 @ v2]).real
    lengths = [s * s * (u1 @ u1) + 2.0 * s * (u1 @ u2) + u2 @ u2 for s in ratios]
    s, length = ratios[int(np.argmax(lengths))], max(lengths)
    q, dual = (s * u1 + u2) / np.sqrt(length), (s * v1 + v2) / np.sqrt(length)
    t = 2.0 * (q[0] * dual[1:] - dual[0] * q[1:] + np.cross(q[1:], dual[1:]))
    return se3.make(se3.rotation_from_quaternion(np.roll(q, -1)), t)


CLOSED_FORMS: dict[str, Callable[[Float64, Float64], Float64]] = {
    "park": park,
    "tsai": tsai,
    "daniilidis": daniilidis,
}


def disagreement(M: Float64, N: Float64) -> tuple[float, float]:
    """How much the closed forms of motions (K, 4, 4) differ: the largest distance between two, metres, and
    the largest angle between two, radians."""
    pairs = list(combinations([solved(M, N) for solved in CLOSED_FORMS.values()], 2))
    return (
        max(float(np.linalg.norm(one[:3, 3] - other[:3, 3])) for one, other in pairs),
        max(se3.rotation_angle(one, other) for one, other in pairs),
    )


def rotation_vectors(M: Float64) -> Float64:
    """Rotation vectors (K, 3) of poses (K, 4, 4), radians."""
    return np.asarray(Rotation.from_matrix(M[:, :3, :3]).as_rotvec())


def _with_translation(M: Float64, N: Float64, R: Float64) -> Float64:
    """X from its known rotation: (R_M - 1) t = R t_N - t_M for all motions, by least squares."""
    left = np.vstack([m[:3, :3] - np.eye(3) for m in M])
    right = np.concatenate([R @ n[:3, 3] - m[:3, 3] for m, n in zip(M, N, strict=True)])
    return se3.make(R, np.linalg.lstsq(left, right, rcond=None)[0])


def _modified(M: Float64) -> Float64:
    """Tsai's modified Rodrigues vectors (K, 3): twice the vector part of the quaternion."""
    return np.array([2.0 * _quaternion(m)[:3] for m in M])


def _screw(T: Float64) -> tuple[Float64, Float64]:
    """Vector parts (3,) of the real and of the dual quaternion of a motion (4, 4)."""
    q, t = _quaternion(T), T[:3, 3]
    return q[:3], 0.5 * (q[3] * t + np.cross(t, q[:3]))


def _quaternion(T: Float64) -> Float64:
    """Quaternion xyzw (4,) with w >= 0: corresponding motions have the same angle, up to 180 degrees."""
    q = se3.quaternion_from_rotation(T[:3, :3])
    return q if q[3] >= 0.0 else -q
