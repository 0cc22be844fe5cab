"""Factor: pull the outline of an object onto depth jumps.

A plane face can slide along itself and still agree in depth and colour; only its outline fixes it. Beyond the
outline depth jumps away from the camera. Each outline point is pulled to the nearest jump across the outline,
while surface samples are held on their readings. Outline points without a jump, as where the object stands on
something, have no weight.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.camera import NEAR_M, POINTS_PER_READING, depth_noise_m
from huepose.geometry.frame import RgbdFrame
from huepose.judge.borders import STEP_M, STEP_SIGMAS, Contours
from huepose.judge.open_region import PreparedSurface

REACH_M, ACROSS_M = 0.03, 0.0015
"""Search range on both sides of the outline, and its step, metres."""

EDGE_M = 0.003
"""RMS error of a jump's position: with stereo cameras, edges are ragged and lie a pixel or two too far
out."""

SAMPLES, GATE_M = 200, 0.015
"""Surface samples, and the largest distance of a reading from the plane of one, metres."""

ROUNDS = 4
"""Gauss-Newton steps; each searches the jumps again."""

DAMPING = 1e-3
"""Damping, as a share of the mean information."""

FEWEST = 0.3
"""Least share of the outline that must have a jump."""


def moved_to_ends(contours: Contours, T_cam_obj: Float64, frame: RgbdFrame) -> Float64 | None:
    """The pose (4, 4) moved so that the object ends where depth jumps; None if too little of the outline has
    a jump."""
    T, surface = T_cam_obj, contours.surface
    for _ in range(ROUNDS):
        points, out = contours.at(T)
        if not len(points):
            return None
        p, o = se3.apply(T, points), out @ T[:3, :3].T
        off, jumps = _jumps(p, o, frame)
        if jumps.mean() < FEWEST:
            return None
        q, n, gap = _gaps(surface, T, frame)
        centre = surface.centre_cam(T)
        noise = depth_noise_m(float(centre[2]))
        weights = np.concatenate(
            [
                jumps * _bisquare(off / REACH_M) / EDGE_M**2,
                _bisquare(gap / GATE_M) / (POINTS_PER_READING * noise**2),
            ]
        )
        arms, along = np.concatenate([p, q]) - centre, np.concatenate([o, n])
        rows = np.concatenate([along, np.cross(arms, along) / surface.radius_m], axis=1)
        A = (rows * weights[:, None]).T @ rows
        A += DAMPING * np.trace(A) / 6.0 * np.eye(6)
        step = np.linalg.solve(A, rows.T @ (weights * np.concatenate([off, gap])))
        rotation = se3.rotation_exp(step[3:] / surface.radius_m)
        T = se3.compose(se3.make(rotation, centre + step[:3] - rotation @ centre), T)
    return T


def _jumps(p: Float64, o: Float64, frame: RgbdFrame) -> tuple[Float64, Bool]:
    """Distance (K,) of the nearest depth jump from each point p (K, 3) of an outline, along o (K, 3), metres,
    and whether there is a jump (K,); camera axes."""
    steps = np.arange(-REACH_M, REACH_M + ACROSS_M, ACROSS_M)
    z = _readings(p[:, None] + steps[:, None] * o[:, None], frame)
    apart = STEP_M + STEP_SIGMAS * depth_noise_m(float(p[:, 2].mean()))
    inner, outer = z[:, :-2], z[:, 2:]
    # What ends at the jump must be the object.
    jump = (inner > 0.0) & (outer - inner > apart) & (np.abs(inner - p[:, 2:]) < REACH_M)
    nearest = np.argmin(np.where(jump, np.abs(steps[1:-1]), np.inf), axis=1)
    return steps[1:-1][nearest], np.asarray(jump.any(axis=1))


def _gaps(surface: PreparedSurface, T: Float64, frame: RgbdFrame) -> tuple[Float64, Float64, Float64]:
    """Points (N, 3) and normals (N, 3) of the visible surface, camera axes, and the distances (N,) of their
    readings from it, metres, positive outside."""
    shown = surface.shown(T, SAMPLES)
    q, n = se3.apply(T, surface.arrays.points[shown]), surface.arrays.normals[shown] @ T[:3, :3].T
    z = _readings(q, frame)
    known = z > 0.0
    q, n, z = q[known], n[known], z[known]
    # The reading is taken on the sample's own ray: an error of half a pixel matters less than that of the
    # surface.
    return q, n, ((z / q[:, 2] - 1.0)[:, None] * q * n).sum(1)


def _readings(points: Float64, frame: RgbdFrame) -> Float64:
    """Depth at points (..., 3) of camera axes; 0 where there is none."""
    camera, depth = frame.camera, frame.depth
    z = np.maximum(points[..., 2], NEAR_M)
    u = np.rint(points[..., 0] / z * camera.fx + camera.cx).astype(np.int64)
    v = np.rint(points[..., 1] / z * camera.fy + camera.cy).astype(np.int64)
    inside = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
    read = depth[np.where(inside, v, 0), np.where(inside, u, 0)].astype(np.float64)
    return np.where(inside & np.isfinite(read), read, 0.0)


def _bisquare(x: Float64) -> Float64:
    """Tukey's weight, 0 from 1 on."""
    return np.maximum(1.0 - x * x, 0.0) ** 2
