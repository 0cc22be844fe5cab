"""The pose of an object at a time without a message: between two poses, or a little after the last.

Poses are translations (3,) in metres and quaternions (4,) xyzw; twists (6,) and covariances (6, 6) have the
order tx ty tz rx ry rz, along the camera's axes, about the object's origin. While the object rotates, its
centre moves on a straight line; an origin far from the centre moves on an arc.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from huepose_protos.fields import StateName
from huepose_protos.messages import Mount, PoseMessage

Array = NDArray[np.float64]
SECOND = 1_000_000_000
MAX_AHEAD_NS = SECOND // 10
# Two poses that are further apart in time are not interpolated.
_MAX_GAP_NS = SECOND // 5
# Two that are nearer in time give no good velocity: measured poses and timestamps have noise.
_BASELINE_NS = SECOND // 50
# One sigma of the motion of a hand or an arm: the error of a published velocity, the acceleration, and the
# velocity if none is published. Metres and radians.
_VELOCITY = np.repeat([0.02, 0.2], 3)
_ACCELERATION = np.repeat([1.0, 8.0], 3)
_UNKNOWN_VELOCITY = np.repeat([0.3, 3.0], 3)
_ROTATION = 1e-3
_WORST_LAST: tuple[StateName, ...] = ("TRACKING", "SUSPECT", "SEARCHING", "LOST")


@dataclass(frozen=True, eq=False)
class PoseAt:
    """A pose at a time. `ahead_s`: how far it is predicted beyond a pose message; 0 if it is interpolated.

    covariance: that of the pose, plus the motion that is possible since; None if the pose has none. basis:
    the newest message that it was computed from. mount: of the camera at that time, None if not known."""

    translation: Array
    quaternion: Array
    covariance: Array | None
    state: StateName
    quality: float
    ahead_s: float
    basis: PoseMessage
    mount: Mount | None = None

    @property
    def T_cam_obj(self) -> Array:
        """The pose as a matrix (4, 4) that takes points of the object to the camera."""
        return _matrix(self.translation, self.quaternion)

    @property
    def T_parent_obj(self) -> Array | None:
        """The pose in the frame `mount.parent`, for example the robot's; None without a mount."""
        if self.mount is None:
            return None
        return _matrix(self.mount.translation, np.array(self.mount.quaternion)) @ self.T_cam_obj


def pose_at(poses: Sequence[PoseMessage], stamp_ns: int) -> PoseAt | None:
    """The pose at a timestamp of the poses' own clock; poses are of one instance, oldest first.

    Between two poses it is interpolated; after the newest, or in a gap of more than 200 ms, it is predicted
    with the velocity for 100 ms. None later than that, before the first, and while there is no pose."""
    after = next((p for p in poses if p.capture_ns >= stamp_ns), None)
    before = next((p for p in reversed(poses) if p.capture_ns <= stamp_ns), None)
    if before is None or before.translation is None:
        return None
    if after is None:
        return _predicted(before, stamp_ns - before.capture_ns)
    if after.translation is None:
        return None
    gap_ns = after.capture_ns - before.capture_ns
    if gap_ns > _MAX_GAP_NS:
        return _predicted(before, stamp_ns - before.capture_ns)
    return _between(before, after, (stamp_ns - before.capture_ns) / gap_ns if gap_ns else 1.0)


def mount_at(mounts: Sequence[tuple[int, Mount]], stamp_ns: int) -> Mount | None:
    """The mount of a moving camera at a timestamp; mounts: with their timestamps, oldest first.

    Between two it is interpolated; after the newest it is extrapolated for 100 ms, with the motion since an
    older one at least 20 ms before. None later than that, before the first, in a gap of more than 200 ms, and
    after the newest if none is so much older."""
    after = min(bisect_left(mounts, stamp_ns, key=_stamp), len(mounts) - 1)
    if not mounts or (after == 0 and mounts[0][0] != stamp_ns):
        return None
    end_ns, end = mounts[after]
    if stamp_ns == end_ns:
        return end
    before, least_ns = after - 1, _BASELINE_NS if stamp_ns > end_ns else 0
    while before > 0 and end_ns - mounts[before][0] < least_ns:
        before -= 1
    start_ns, start = mounts[before]
    if not least_ns <= end_ns - start_ns <= _MAX_GAP_NS:
        return None
    if stamp_ns - end_ns > MAX_AHEAD_NS or end.parent != start.parent:
        return None
    share = (stamp_ns - start_ns) / (end_ns - start_ns)
    return mount_of(end.parent, *_interpolated(start, end, share))


def _stamp(mount: tuple[int, Mount]) -> int:
    return mount[0]


def composed(outer: Mount, inner: Mount) -> Mount:
    """The mount `inner`, which is given in the frame that `outer` places, in the parent of `outer`."""
    R = rotation_matrix(np.array(outer.quaternion))
    translation = R @ np.array(inner.translation) + np.array(outer.translation)
    quaternion = multiply(np.array(outer.quaternion), np.array(inner.quaternion))
    return mount_of(outer.parent, translation, quaternion)


def carried(pose: PoseMessage, mount: Mount, still: bool) -> PoseMessage:
    """The same message in the frame that its camera is mounted in: pose, covariance and velocity along its
    axes, `frame` its name. still: whether the camera is fixed; if it moves, the velocity, which is relative
    to the camera, is left out."""
    if pose.translation is None or pose.quaternion is None:
        return msgspec.structs.replace(pose, frame=mount.parent)
    in_camera = Mount(parent=pose.frame, translation=pose.translation, quaternion=pose.quaternion)
    in_parent = composed(mount, in_camera)
    R = rotation_matrix(np.array(mount.quaternion))
    linear, angular, covariance = pose.velocity_linear, pose.velocity_angular, None
    if pose.covariance is not None:
        both = np.kron(np.eye(2), R)
        rotated = both @ _covariance(pose) @ both.T
        np.fill_diagonal(rotated, np.maximum(np.diag(rotated), 0.0))  # rounding makes no variance negative
        covariance = rotated.ravel().tolist()
    return msgspec.structs.replace(
        pose,
        frame=mount.parent,
        translation=in_parent.translation,
        quaternion=in_parent.quaternion,
        velocity_linear=tuple((R @ linear).tolist()) if still and linear is not None else None,
        velocity_angular=tuple((R @ angular).tolist()) if still and angular is not None else None,
        covariance=covariance,
    )


def inverted(mount: Mount, parent: str) -> Mount:
    """The inverse: the pose of the frame `mount.parent` in the mounted frame, which is named `parent`."""
    q = _inverse(np.array(mount.quaternion))
    return mount_of(parent, -rotation_matrix(q) @ np.array(mount.translation), q)


def rigid(T: ArrayLike) -> Array:
    """The transform (4, 4) in float64. Raises ValueError if it is no rigid motion: a quaternion cannot show
    that a matrix is mirrored, scaled or sheared."""
    matrix = np.asarray(T, dtype=np.float64)
    found = ""
    if matrix.shape != (4, 4):
        found = f"shape {matrix.shape}"
    elif not np.isfinite(matrix).all():
        found = "numbers that are not finite"
    elif np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max() > _ROTATION:
        found = f"the last row {matrix[3].tolist()}"
    elif np.abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max() > _ROTATION:
        found = "a rotation that is scaled or sheared"
    elif np.linalg.det(matrix[:3, :3]) < 0.0:
        found = "a rotation that is mirrored"
    if found:
        raise ValueError(
            f"the pose is no rigid motion: found {found}; expected a (4, 4) matrix of a rotation, a "
            "translation in metres and the last row 0 0 0 1"
        )
    return matrix


def mount_of(parent: str, translation: Array, quaternion: Array) -> Mount:
    """The mount of a translation (3,) and a quaternion (4,) xyzw."""
    x, y, z = translation.tolist()
    qx, qy, qz, qw = _normal(quaternion).tolist()
    return Mount(parent=parent, translation=(x, y, z), quaternion=(qx, qy, qz, qw))


def _predicted(pose: PoseMessage, ahead_ns: int) -> PoseAt | None:
    if ahead_ns > MAX_AHEAD_NS:
        return None
    dt = ahead_ns * 1e-9
    linear, angular = np.zeros(3), np.zeros(3)
    sigma = _UNKNOWN_VELOCITY
    if pose.velocity_linear is not None and pose.velocity_angular is not None:
        linear, angular, sigma = np.array(pose.velocity_linear), np.array(pose.velocity_angular), _VELOCITY
    q = np.array(pose.quaternion)
    quaternion = _normal(multiply(quaternion_of(angular * dt), q))
    lever, lever_then = -_to_centre(pose, q), -_to_centre(pose, quaternion)
    covariance = None
    if pose.covariance is not None:
        growth = (sigma * dt) ** 2 + (0.5 * _ACCELERATION * dt * dt) ** 2
        to_origin = np.eye(6)
        to_origin[:3, 3:] = np.cross(np.eye(3), lever_then).T
        covariance = _covariance(pose) + to_origin @ np.diag(growth) @ to_origin.T
    centre = np.array(pose.translation) - lever + (linear - np.cross(angular, lever)) * dt
    return PoseAt(centre + lever_then, quaternion, covariance, pose.state, pose.quality, dt, pose)


def _between(before: PoseMessage, after: PoseMessage, share: float) -> PoseAt:
    covariance = None
    if before.covariance is not None and after.covariance is not None:
        covariance = (1.0 - share) * _covariance(before) + share * _covariance(after)
    origin, quaternion = _interpolated(before, after, share)
    start, end = (_to_centre(before, np.array(pose.quaternion)) for pose in (before, after))
    return PoseAt(
        origin + (1.0 - share) * start + share * end - _to_centre(before, quaternion),
        quaternion,
        covariance,
        max(before.state, after.state, key=_WORST_LAST.index),
        min(before.quality, after.quality),
        0.0,
        after,
    )


def _to_centre(pose: PoseMessage, quaternion: Array) -> Array:
    """The vector (3,) from the object's origin to its centre, in this orientation."""
    return np.asarray(rotation_matrix(quaternion) @ np.array(pose.centre))


def _interpolated(
    before: Mount | PoseMessage, after: Mount | PoseMessage, share: float
) -> tuple[Array, Array]:
    """Translation and quaternion at a share of the way from one pose to another; more than 1 extrapolates."""
    a, b = np.array(before.quaternion), np.array(after.quaternion)
    rotation = rotation_vector(multiply(b, _inverse(a)))
    translation = (1.0 - share) * np.array(before.translation) + share * np.array(after.translation)
    return translation, _normal(multiply(quaternion_of(share * rotation), a))


def _matrix(translation: ArrayLike, quaternion: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_matrix(quaternion), translation
    return T


def _covariance(pose: PoseMessage) -> Array:
    return np.array(pose.covariance, dtype=np.float64).reshape(6, 6)


def multiply(p: Array, q: Array) -> Array:
    """The rotation q, then p; xyzw."""
    u, v = p[:3], q[:3]
    return np.append(p[3] * v + q[3] * u + np.cross(u, v), p[3] * q[3] - u @ v)


def _inverse(q: Array) -> Array:
    return np.append(-q[:3], q[3])


def _normal(q: Array) -> Array:
    return np.asarray(q / np.linalg.norm(q), dtype=np.float64)


def quaternion_of(rotation_vector: Array) -> Array:
    """xyzw of a rotation vector (3,) in radians."""
    angle = float(np.linalg.norm(rotation_vector))
    # sin(x / 2) / x; numpy's sinc avoids the division by zero.
    return np.append(0.5 * np.sinc(angle / (2.0 * np.pi)) * rotation_vector, np.cos(0.5 * angle))


def rotation_vector(q: Array) -> Array:
    """The shorter rotation vector (3,) of xyzw."""
    if q[3] < 0.0:
        q = -q
    length = float(np.linalg.norm(q[:3]))
    if length < 1e-12:
        return np.asarray(2.0 * q[:3], dtype=np.float64)
    return np.asarray(2.0 * np.arctan2(length, q[3]) / length * q[:3], dtype=np.float64)


def quaternion_from(R: Array) -> Array:
    """xyzw of a rotation matrix (3, 3): the eigenvector of K's largest eigenvalue (Bar-Itzhack)."""
    K = np.array(
        [
            [R[0, 0] - R[1, 1] - R[2, 2], 0.0, 0.0, 0.0],
            [R[1, 0] + R[0, 1], R[1, 1] - R[0, 0] - R[2, 2], 0.0, 0.0],
            [R[2, 0] + R[0, 2], R[2, 1] + R[1, 2], R[2, 2] - R[0, 0] - R[1, 1], 0.0],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R[0, 0] + R[1, 1] + R[2, 2]],
        ]
    )
    return np.asarray(np.linalg.eigh(K)[1][:, -1])


def rotation_matrix(q: Array) -> Array:
    """Matrix (3, 3) of xyzw."""
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
