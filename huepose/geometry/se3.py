"""Rigid transforms as 4x4 arrays; `T_a_b` maps b coordinates into a. Rotation vectors in radians.

A twist is `[v, w]` (translation first) and is applied on the left in camera axes about the object's
origin where a covariance or a velocity is meant (see `perturb`); `exp` and `log` are the usual SE(3) maps.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float64


def make(R: Float, t: Float) -> Float64:
    """4x4 transform from a 3x3 rotation and a translation (3,)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse(T: Float) -> Float64:
    """Inverse of a rigid transform (4, 4)."""
    return make(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])


def orthonormalised(T: Float) -> Float64:
    """The nearest rigid transform to `T` (4, 4): singular values of its rotation set to one, det +1."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
    return make(U @ Vt, T[:3, 3])


def compose(*transforms: Float) -> Float64:
    """Product of transforms, re-orthonormalised: `compose(T_a_b, T_b_c)` is T_a_c."""
    T = np.eye(4)
    for X in transforms:
        T = T @ X
    return orthonormalised(T)


def apply(T: Float, points: Float) -> Float64:
    """Transform points (..., 3)."""
    return np.asarray(points @ T[:3, :3].T + T[:3, 3], dtype=np.float64)


def hat(w: Float) -> Float64:
    """Skew matrix (3, 3) of a vector (3,): `hat(w) @ x == cross(w, x)`."""
    x, y, z = (float(a) for a in w)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_exp(w: Float) -> Float64:
    """Rotation matrix (3, 3) of a rotation vector (3,) in radians."""
    angle = float(np.linalg.norm(w))
    K = hat(w)
    if angle < 1e-8:
        return np.asarray(np.eye(3) + K + 0.5 * K @ K)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * (K @ K))


def rotation_log(R: Float) -> Float64:
    """Rotation vector (3,) of a rotation matrix (3, 3), angle in [0, pi]; exact near 0 and near pi."""
    q = quaternion_from_rotation(R)
    if q[3] < 0:
        q = -q
    s = float(np.linalg.norm(q[:3]))
    if s < 1e-12:
        return 2.0 * q[:3]
    return np.asarray(q[:3] / s * 2.0 * np.arctan2(s, q[3]))


def rotation_angle(R_a: Float, R_b: Float) -> float:
    """Geodesic distance of two rotations (3, 3) or transforms (4, 4), radians in [0, pi]."""
    return float(np.linalg.norm(rotation_log(np.asarray(R_a)[:3, :3].T @ np.asarray(R_b)[:3, :3])))


def quaternion_from_rotation(R: Float) -> Float64:
    """Unit quaternion xyzw (4,) of a rotation matrix (3, 3); from the largest of its four components."""
    m = np.asarray(R, dtype=np.float64)
    d = np.array([m[0, 0], m[1, 1], m[2, 2], m[0, 0] + m[1, 1] + m[2, 2]])
    k = int(np.argmax(d))
    if k == 3:
        q = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1.0 + d[3]])
    else:
        i, j, l = k, (k + 1) % 3, (k + 2) % 3
        q = np.empty(4)
        q[i] = 1.0 - d[3] + 2.0 * m[i, i]
        q[j] = m[j, i] + m[i, j]
        q[l] = m[l, i] + m[i, l]
        q[3] = m[l, j] - m[j, l]
    return np.asarray(q / np.linalg.norm(q))


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
    angle = float(np.linalg.norm(w))
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
    angle = float(np.linalg.norm(w))
    K = hat(w)
    if angle < 1e-6:
        V_inv = np.eye(3) - 0.5 * K + K @ K / 12.0
    else:
        half = 0.5 * angle
        V_inv = np.eye(3) - 0.5 * K + (1 - half / np.tan(half)) / angle**2 * (K @ K)
    return np.concatenate([V_inv @ T[:3, 3], w])


def interpolate(T_0: Float, T_1: Float, s: float) -> Float64:
    """Pose between `T_0` (s = 0) and `T_1` (s = 1): shortest rotation, straight translation."""
    R = T_0[:3, :3] @ rotation_exp(s * rotation_log(T_0[:3, :3].T @ T_1[:3, :3]))
    return orthonormalised(make(R, (1 - s) * T_0[:3, 3] + s * T_1[:3, 3]))


def perturb(T_cam_obj: Float, delta: Float) -> Float64:
    """Move a pose by `delta` = tx ty tz rx ry rz (6,): a small translation and a small rotation about the
    object's origin, both along camera axes. The convention of every covariance and velocity here."""
    d = np.asarray(delta, float)
    return orthonormalised(make(rotation_exp(d[3:]) @ T_cam_obj[:3, :3], T_cam_obj[:3, 3] + d[:3]))


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
    trace = np.einsum("nij,ij->n", np.asarray(rotations, np.float64), np.asarray(reference, np.float64))
    return np.asarray(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
