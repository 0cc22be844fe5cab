"""Rigid transforms as 4x4 arrays; `T_a_b` maps b coordinates into a. Rotation vectors in radians.

A twist is `[v, w]`, translation first. `exp` and `log` are the usual SE(3) maps of twists. Covariances and
velocities use the motion of `perturb` instead: along camera axes, about the object's origin. A covariance
of a pose is (6, 6), in the order tx ty tz rx ry rz, in metres and radians.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

import numpy as np

from huepose.geometry.arrays import Float, Float64

ROUNDED = 1e-2
"""Tolerance of `is_rigid` for a transform whose numbers were rounded in a file."""

NEARLY_ORTHONORMAL = 1e-7
"""Largest norm of I - R^T R at which one Newton-Schulz step, which squares it, reaches machine
precision."""


def make(R: Float, t: Float) -> Float64:
    """4x4 transform from a 3x3 rotation and a translation (3,)."""
    T = _IDENTITY.copy()
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse(T: Float) -> Float64:
    """Inverse of a rigid transform (4, 4)."""
    return make(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])


def orthonormalised(T: Float) -> Float64:
    """The nearest rigid transform to `T` (4, 4): singular values of its rotation set to one, det +1."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z) = np.asarray(T, np.float64)[:3].tolist()
    # Half of I - R^T R, which is symmetric. In plain numbers, because it runs some hundred times per frame.
    xx, xy = 0.5 * (1.0 - a * a - d * d - g * g), -0.5 * (a * b + d * e + g * h)
    yy, xz = 0.5 * (1.0 - b * b - e * e - h * h), -0.5 * (a * c + d * f + g * i)
    zz, yz = 0.5 * (1.0 - c * c - f * f - i * i), -0.5 * (b * c + e * f + h * i)
    square = xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)
    positive = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0.0
    if 4.0 * square < NEARLY_ORTHONORMAL**2 and positive:
        return np.array(
            [
                [a + a * xx + b * xy + c * xz, b + a * xy + b * yy + c * yz, c + a * xz + b * yz + c * zz, x],
                [d + d * xx + e * xy + f * xz, e + d * xy + e * yy + f * yz, f + d * xz + e * yz + f * zz, y],
                [g + g * xx + h * xy + i * xz, h + g * xy + h * yy + i * yz, i + g * xz + h * yz + i * zz, z],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    U, _, Vt = np.linalg.svd(np.array([[a, b, c], [d, e, f], [g, h, i]]))
    U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
    return make(U @ Vt, T[:3, 3])


_IDENTITY, _ORIGIN = np.eye(4), np.zeros(3)

ACCELERATION = np.array([4.0, 4.0, 4.0, 20.0, 20.0, 20.0])
"""Assumed RMS acceleration of a body that is not measured, m/s^2 and rad/s^2."""


def compose(*transforms: Float) -> Float64:
    """Product of transforms, re-orthonormalised: `compose(T_a_b, T_b_c)` is T_a_c."""
    T = np.eye(4) if not transforms else np.asarray(transforms[0], np.float64)
    for X in transforms[1:]:
        T = T @ X
    return orthonormalised(T)


def moved(T: Float, point: Float, motion: Float) -> Float64:
    """The pose T (4, 4) of a body after a motion [v, w] (6,), metres and radians: `point` (3,) in the body's
    axes moves by v, and the body rotates about it by w, in the axes of T's parent."""
    R = rotation_exp(motion[3:]) @ T[:3, :3]
    return orthonormalised(make(R, T[:3, :3] @ point + T[:3, 3] + motion[:3] - R @ point))


def apply(T: Float, points: Float) -> Float64:
    """Transform points (..., 3)."""
    return np.asarray(points @ T[:3, :3].T + T[:3, 3], dtype=np.float64)


def length(v: Float) -> float:
    """Euclidean norm of a vector (N,); for few numbers in a quarter of `np.linalg.norm`'s time."""
    return sqrt(v.dot(v))


def hat(w: Float) -> Float64:
    """Skew matrix (3, 3) of a vector (3,): `hat(w) @ x == cross(w, x)`."""
    x, y, z = np.asarray(w, np.float64).tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_exp(w: Float) -> Float64:
    """Rotation matrix (3, 3) of a rotation vector (3,) in radians."""
    x, y, z = np.asarray(w, np.float64).tolist()
    square = x * x + y * y + z * z
    angle = sqrt(square)
    a, b = (1.0, 0.5) if angle < 1e-8 else (sin(angle) / angle, (1.0 - cos(angle)) / square)
    return np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )


def rotation_log(R: Float) -> Float64:
    """Rotation vector (3,) of a rotation matrix (3, 3), angle in [0, pi]; exact near 0 and near pi."""
    x, y, z, w = _quaternion(R)
    s = sqrt(x * x + y * y + z * z)
    factor = 2.0 if s < 1e-12 else 2.0 * atan2(s, abs(w)) / s
    return np.array([x, y, z]) * (-factor if w < 0.0 else factor)


def rotation_angle(R_a: Float, R_b: Float) -> float:
    """Geodesic distance of two rotations (3, 3) or transforms (4, 4), radians in [0, pi]."""
    x, y, z, w = _quaternion(np.asarray(R_a)[:3, :3].T @ np.asarray(R_b)[:3, :3])
    return 2.0 * atan2(sqrt(x * x + y * y + z * z), abs(w))


def quaternion_from_rotation(R: Float) -> Float64:
    """Unit quaternion xyzw (4,) of a rotation matrix (3, 3); from the largest of its four components."""
    return np.array(_quaternion(R))


def _quaternion(R: Float) -> tuple[float, float, float, float]:
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(R, np.float64).tolist()
    trace = a + e + i
    largest = max(a, e, i, trace)
    if largest == trace:
        x, y, z, w = h - f, c - g, d - b, 1.0 + trace
    elif largest == a:
        x, y, z, w = 1.0 - trace + 2.0 * a, d + b, g + c, h - f
    elif largest == e:
        x, y, z, w = b + d, 1.0 - trace + 2.0 * e, h + f, c - g
    else:
        x, y, z, w = c + g, f + h, 1.0 - trace + 2.0 * i, d - b
    length = sqrt(x * x + y * y + z * z + w * w)
    return x / length, y / length, z / length, w / length


def rotation_from_quaternion(q: Float) -> Float64:
    """Rotation matrix (3, 3) of a quaternion xyzw (4,); it is normalised first."""
    x, y, z, w = np.asarray(q, dtype=np.float64) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def exp(twist: Float) -> Float64:
    """SE(3) exponential of a twist [v, w] (6,)."""
    v, w = np.asarray(twist[:3], float), np.asarray(twist[3:], float)
    angle = length(w)
    K = hat(w)
    if angle < 1e-6:
        V = np.eye(3) + 0.5 * K + K @ K / 6.0
    else:
        a = (1 - np.cos(angle)) / angle**2
        b = (angle - np.sin(angle)) / angle**3
        V = np.eye(3) + a * K + b * (K @ K)
    return make(rotation_exp(w), V @ v)


def log(T: Float) -> Float64:
    """Twist [v, w] (6,) of a rigid transform; inverse of `exp` for angles under pi."""
    w = rotation_log(T[:3, :3])
    angle = length(w)
    K = hat(w)
    if angle < 1e-6:
        V_inv = np.eye(3) - 0.5 * K + K @ K / 12.0
    else:
        half = 0.5 * angle
        V_inv = np.eye(3) - 0.5 * K + (1 - half / np.tan(half)) / angle**2 * (K @ K)
    return np.concatenate([V_inv @ T[:3, 3], w])


def interpolate(T_0: Float, T_1: Float, s: float, about: Float = _ORIGIN) -> Float64:
    """Pose between `T_0` (s = 0) and `T_1` (s = 1). It rotates the shortest way, and the point `about` (3,)
    of the body, by default its origin, moves on a straight line."""
    R = T_0[:3, :3] @ rotation_exp(s * rotation_log(T_0[:3, :3].T @ T_1[:3, :3]))
    start, end = (T[:3, :3] @ about + T[:3, 3] for T in (T_0, T_1))
    return orthonormalised(make(R, (1 - s) * start + s * end - R @ about))


def perturb(T_cam_obj: Float, delta: Float) -> Float64:
    """Move a pose by `delta` = tx ty tz rx ry rz (6,): a small translation and a small rotation about the
    object's origin, both along camera axes. All covariances and velocities use this convention."""
    T = np.array(T_cam_obj, np.float64)
    T[:3, :3] = rotation_exp(delta[3:]) @ T[:3, :3]
    T[:3, 3] += delta[:3]
    return orthonormalised(T)


def difference(T_from: Float, T_to: Float) -> Float64:
    """The `delta` (6,) with `perturb(T_from, delta) == T_to`."""
    w = rotation_log(T_to[:3, :3] @ T_from[:3, :3].T)
    return np.concatenate([T_to[:3, 3] - T_from[:3, 3], w])


def is_rigid(T: Float, tolerance: float = 1e-4) -> bool:
    """True for a finite 4x4 transform with an orthonormal rotation of determinant +1."""
    T = np.asarray(T)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return False
    R = T[:3, :3]
    return bool(
        np.allclose(R.T @ R, np.eye(3), atol=tolerance)
        and np.linalg.det(R) > 0
        and np.allclose(T[3], [0, 0, 0, 1], atol=tolerance)
    )


def angles_to(rotations: Float, reference: Float) -> Float64:
    """Geodesic distances (N,) in radians of rotations (N, 3, 3) to one (3, 3)."""
    rotations, reference = np.asarray(rotations, np.float64), np.asarray(reference, np.float64)
    sines = np.sqrt(((rotations - reference) ** 2).sum((1, 2)) / 8.0)
    cosines = np.sqrt(np.maximum(0.0, 1.0 + np.einsum("nij,ij->n", rotations, reference)) / 4.0)
    return np.asarray(2.0 * np.arctan2(sines, cosines))


def carrying(lever: Float) -> Float64:
    """Matrix (6, 6) that converts a small motion about one point of a body into the same motion about
    another. lever (3,): from the first point to the second, metres, camera axes. A covariance C about the
    first point is `carrying(lever) @ C @ carrying(lever).T` about the second.

    >>> carrying([0.0, 0.0, 2.0]) @ [0, 0, 0, 0.1, 0, 0]
    array([ 0. , -0.2,  0. ,  0.1,  0. ,  0. ])
    """
    out = np.eye(6)
    out[:3, 3:] = -hat(np.asarray(lever, np.float64))
    return out


def along(R: Float) -> Float64:
    """Matrix (6, 6) that rotates the coordinates of twists by R (3, 3). A covariance C becomes
    `along(R) @ C @ along(R).T`.

    >>> along(rotation_exp([0.0, 0.0, np.pi / 2])).round() @ [1, 0, 0, 0, 1, 0]
    array([ 0.,  1.,  0., -1.,  0.,  0.])
    """
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = R
    return out


def mahalanobis(T_a: Float, T_b: Float, covariance: Float) -> float:
    """Distance of two poses in standard deviations of `covariance` (6, 6), positive definite."""
    delta = difference(np.asarray(T_a), np.asarray(T_b))
    squared = float(delta @ np.linalg.solve(np.asarray(covariance), delta))
    return float(np.sqrt(max(0.0, squared)))


def grown(covariance: Float, seconds: float, lever: Float = _ORIGIN, unseen_s: float = 0.0) -> Float64:
    """`covariance` (6, 6) after `seconds` more without a measurement, in which the body may have
    accelerated.

    unseen_s: seconds without a measurement for which the covariance has grown already. lever (3,): from the
    point that the covariance is about to the centre of the body, about which it rotates; metres, camera
    axes."""
    to_point = carrying(-np.asarray(lever))
    growth = _growth(unseen_s + seconds) - _growth(unseen_s)
    return np.asarray(covariance, np.float64) + to_point @ np.diag(growth) @ to_point.T


def _growth(seconds: float) -> Float64:
    """Variances (6,) after `seconds` of unknown acceleration, m^2 and rad^2."""
    return np.asarray((0.5 * ACCELERATION * seconds**2) ** 2)
