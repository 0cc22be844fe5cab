"""Motion in the built-in scene: closed paths with two continuous derivatives, also where the loop closes.

A path is a cyclic cubic B-spline, for rotations in its cumulative form (Kim, Kim and Shin 1995). Motion is
slow at the beginning of the loop and fast afterwards, as when someone picks up objects one by one. Positions
are in the frame `room`, which is that of the camera at rest (x right, y down, z forward).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from huepose.geometry.arrays import Bool, Float, Float64, Rng
from huepose.geometry.camera import Camera
from huepose.scenes.camera import RATE_HZ

CALM_S = 1.5  # at the beginning of the loop: objects are slow, and none occludes another
PITCH = np.radians(35.0)  # by which the camera looks down
UP_ROOM = np.array([0.0, -np.cos(PITCH), -np.sin(PITCH)])
AHEAD_ROOM = np.array([0.0, -np.sin(PITCH), np.cos(PITCH)])  # along the table
TABLE_M = 0.78  # height of the camera over the table
NEAREST_M, FARTHEST_M = 0.57, 1.0  # of the centres of labelled objects


@dataclass(frozen=True, eq=False)
class Timing:
    """The N frames of a loop. phase (N,) in 0..1: position along every path in each frame, smooth, and slow
    at both ends; calm (N,) bool: frames of the calm beginning and of the last half second."""

    phase: Float64
    calm: Bool

    @staticmethod
    def of(n_frames: int) -> Timing:
        """The timing of a loop of `n_frames`."""
        t = np.arange(n_frames) / RATE_HZ
        length = n_frames / RATE_HZ
        fine = np.linspace(0.0, length, 4096)
        rise = _smooth_step((fine - 0.8) / 1.4) * (1 - _smooth_step((fine - length + 0.9) / 0.9))
        speed = 0.22 + 0.78 * rise
        way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)])
        phase = np.interp(t, fine, way / way[-1])
        return Timing(phase, (t < CALM_S) | (t >= length - 0.5))

    @property
    def length_s(self) -> float:
        """Seconds until the loop begins again."""
        return len(self.phase) / RATE_HZ


def _smooth_step(x: Float) -> Float64:
    """0 below 0, 1 above 1, with two continuous derivatives."""
    s = np.clip(x, 0.0, 1.0)
    return np.asarray(s**3 * (10 - 15 * s + 6 * s**2), np.float64)


def positions(control: Float, phase: Float) -> Float64:
    """Points (N, D) at phases (N,) of the cyclic cubic B-spline with control points (K, D)."""
    index, weights = _cubic(len(control), phase)
    return np.asarray((weights[..., None] * control[index]).sum(1), np.float64)


def rotations(control: Float, phase: Float) -> Float64:
    """Rotations (N, 3, 3) at phases (N,) of the cyclic spline with control rotations (K, 3, 3)."""
    index, weights = _cubic(len(control), phase)
    at = Rotation.from_matrix(control)
    steps = (at[np.arange(len(control)) - 1].inv() * at).as_rotvec()  # from the control rotation before
    total = at[index[:, 0]]
    for k in (1, 2, 3):
        share = weights[:, k:].sum(1)
        total = total * Rotation.from_rotvec(share[:, None] * steps[index[:, k]])
    return np.asarray(total.as_matrix(), np.float64)


def _cubic(n: int, phase: Float) -> tuple[np.ndarray, Float64]:
    """Indices (N, 4) and weights (N, 4) of the control points that act at each phase."""
    where = np.asarray(phase, np.float64) % 1.0 * n
    first = np.floor(where).astype(np.int64)
    u = where - first
    weights = (
        np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], -1) / 6.0
    )
    return (first[:, None] + np.arange(-1, 3)) % n, weights


def speeds(poses: Float) -> tuple[Float64, Float64]:
    """Linear (m/s) and angular (rad/s) speeds (N,) of a closed loop of poses (N, 4, 4)."""
    following = np.roll(poses, -1, axis=0)
    linear = np.linalg.norm(following[:, :3, 3] - poses[:, :3, 3], axis=1)
    turn = Rotation.from_matrix(np.swapaxes(poses[:, :3, :3], 1, 2) @ following[:, :3, :3])
    return np.asarray(linear * RATE_HZ), np.asarray(turn.magnitude() * RATE_HZ)


def object_paths(radii: Float, camera: Camera, timing: Timing, rng: Rng, haste: float = 1.0) -> Float64:
    """Poses T_room_obj (objects, N, 4, 4) of objects with bounding radii (objects,) m about their origins.

    They stay in view, over the table, apart from each other in space, and mostly apart in the image. Peak
    speeds are 0.35 to 0.6 m/s, times `haste`, and 150 to 370 degrees a second. Slower paths are shorter, so
    more objects have room. Raises RuntimeError if the objects have no room.
    """
    focal = (camera.fx + camera.fy) / 2
    fits = 1.6 * focal * max(radii) / FARTHEST_M < min(camera.width, camera.height) + 8
    for _ in range(200 if fits else 0):
        tracks: list[Float64] = []
        for radius in radii:
            track = _place(float(radius), radii[: len(tracks)], tracks, camera, timing, rng, haste)
            if track is None:
                break
            tracks.append(track)
        if len(tracks) == len(radii):
            poses = np.tile(np.eye(4), (len(radii), len(timing.phase), 1, 1))
            poses[:, :, :3, 3] = tracks
            for k in range(len(radii)):
                poses[k, :, :3, :3] = _tumble(timing, rng)
            return poses
    raise RuntimeError(f"no room in view for {len(radii)} objects")


def _controls(timing: Timing) -> int:
    return max(5, round(timing.length_s / 0.55))


def _place(
    radius: float, radii: Float, others: list[Float64], camera: Camera, timing: Timing, rng: Rng, haste: float
) -> Float64 | None:
    """Positions (N, 3) of one more object, clear of those of the others; None if no random path is."""
    n, k = 192, _controls(timing)
    depth = rng.uniform(NEAREST_M + 0.06, FARTHEST_M - 0.04, n)
    pixel = rng.uniform(0.16, 0.84, (n, 2)) * (camera.width, camera.height)
    wander = rng.normal(0, 1, (n, k, 3)) * (0.8, 0.7, 1.0)
    paths = positions(np.eye(k), timing.phase) @ wander
    fastest = np.linalg.norm(np.roll(paths, -1, 1) - paths, axis=2).max(1) * RATE_HZ
    amplitude = haste * rng.uniform(0.35, 0.6, n) / fastest
    paths = (paths - paths.mean(1, keepdims=True)) * amplitude[:, None, None]
    paths += camera.backproject(pixel, depth)[:, None]
    paths = paths[
        (paths[..., 2] > NEAREST_M).all(1)
        & (paths[..., 2] < FARTHEST_M).all(1)
        & (paths @ UP_ROOM > radius + 0.01 - TABLE_M).all(1)
    ]
    for other, r in zip(others, radii, strict=True):
        paths = paths[(np.linalg.norm(paths - other, axis=2) > radius + r).all(1)]

    focal = (camera.fx + camera.fy) / 2
    seen, disc = camera.project(paths), 0.8 * focal * radius / paths[..., 2]
    inside = (seen > disc[..., None] - 4) & (
        seen < np.array([camera.width, camera.height]) - disc[..., None] + 4
    )
    good = inside.all((1, 2))
    for other, r in zip(others, radii, strict=True):
        # No two fully occlude each other. In calm frames they do not touch in the image.
        share = np.linalg.norm(seen - camera.project(other), axis=2) / (disc + 0.8 * focal * r / other[:, 2])
        good &= (share > 0.5).all(1) & (share[:, timing.calm] > 1.05).all(1)
        good &= (share < 0.8).mean(1) < 0.12
    found = np.flatnonzero(good)
    return np.asarray(paths[found[0]], np.float64) if len(found) else None


def _tumble(timing: Timing, rng: Rng) -> Float64:
    """Rotations (N, 3, 3) of a nearly upright object: full revolutions about the vertical, and a wobble. The
    wobble is scaled so that the largest speed is between 150 and 370 degrees a second."""
    n = _controls(timing)
    stand = upright(rng.uniform(0, 2 * np.pi))
    turns = int(rng.integers(-1, 2))
    spin = Rotation.from_rotvec(np.outer(np.arange(n) * (2 * np.pi * turns / n), UP_ROOM)).as_matrix()
    wobble = rng.normal(0, 1, (n, 3))
    fastest = np.radians(rng.uniform(150, 370))
    poses = np.tile(np.eye(4), (len(timing.phase), 1, 1))

    def rotated(amplitude: float) -> Float64:
        control = Rotation.from_rotvec(amplitude * wobble).as_matrix() @ spin @ stand
        return rotations(control, timing.phase)

    low, high = 0.0, 1.1
    for _ in range(10):
        middle = (low + high) / 2
        poses[:, :3, :3] = rotated(middle)
        slower = speeds(poses)[1].max() < fastest
        low, high = (middle, high) if slower else (low, middle)
    return rotated(low)


def upright(yaw: float) -> Float64:
    """Rotation R_room_obj (3, 3) of an object upright on the table, z up, rotated about z by `yaw`."""
    right = np.array([1.0, 0.0, 0.0])
    table = np.stack([right, np.cross(UP_ROOM, right), UP_ROOM], -1)
    return np.asarray(table @ Rotation.from_rotvec([0, 0, yaw]).as_matrix(), np.float64)


def camera_sway(timing: Timing, rng: Rng) -> Float64:
    """Poses T_cam_room (N, 4, 4) of a camera in a steady hand: about 1 cm and half a degree to each side."""
    n = max(4, round(timing.length_s / 1.3))
    poses = np.tile(np.eye(4), (len(timing.phase), 1, 1))
    when = np.arange(len(timing.phase)) / len(timing.phase)
    turns = Rotation.from_rotvec(rng.normal(0, np.radians(0.6), (n, 3))).as_matrix()
    poses[:, :3, :3] = rotations(turns, when)
    poses[:, :3, 3] = positions(rng.normal(0, 0.008, (n, 3)), when)
    return poses


def passing(timing: Timing, rng: Rng, distance_m: float, reach_m: float) -> Float64:
    """Poses T_room_obj (N, 4, 4) of a bar along y that passes between camera and objects, to one side and
    later back. In between it waits out of view, `reach_m` beside the optical axis."""
    t = np.arange(len(timing.phase)) / RATE_HZ
    length = timing.length_s
    there, back = 0.24 * length + rng.uniform(0, 0.05 * length), 0.6 * length + rng.uniform(0, 0.05 * length)
    takes = min(2.8, 0.3 * length)
    side = _smooth_step((t - there) / takes) - _smooth_step((t - back) / takes)
    sign = rng.choice([-1.0, 1.0])
    poses = np.tile(np.eye(4), (len(t), 1, 1))
    tilt = sign * (0.25 - 0.5 * side)
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(tilt, [0, 0, 1.0])).as_matrix()
    poses[:, 0, 3] = sign * reach_m * (2 * side - 1)
    poses[:, 1, 3] = rng.uniform(-0.04, 0.04) + 0.03 * np.sin(2 * np.pi * side)
    poses[:, 2, 3] = distance_m
    return poses
