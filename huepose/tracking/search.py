"""The tracker's own search on the current frame, for steps that no local method bridges.

At every fifth frame of a fast hand an object turns by up to 60 degrees and moves by its own length: nothing
of the last frame's pixels is where it was, but the model's colours and the depth are. Positions come first (a
grid over the image, at the depth that is there, for a few rotations), then rotations at the best positions,
then short refinements of the best poses; each stage is sorted by the score of few samples at a coarse
texture level.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.tracking.refinement import COARSE, FINE, refine
from huepose.tracking.region import Region, prepare
from huepose.tracking.scoring import score, score_all, tolerance_m
from huepose.tracking.surface import TrackedSurface

POSITION_SAMPLES, ROTATION_SAMPLES, POSE_SAMPLES = 60, 100, 250
POSITIONS, POSES, FINALISTS = 5, 24, 5
POSITION_STEP = 0.12
POSITION_TURN = np.radians(40.0)
"""Positions are tried with the expected rotations and these far turns of them."""

ROTATION_STEP = np.radians(18.0)
DIFFERENT_TURN = np.radians(12.0)
LEVEL = 2
"""Coarse colours have the widest basins."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Where to look: within `distance_m` of the centre (3,), within `angle_rad` of any of the rotations."""

    centre_cam: Float64
    rotations: tuple[Float64, ...]
    distance_m: float
    angle_rad: float


def search(surface: TrackedSurface, frame: RgbdFrame, reach: Reach) -> tuple[Float64, float] | None:
    """The best pose (4, 4) within reach and its score at the middle texture level; None when no depth is
    there."""
    region = _region(surface, frame, reach)
    if region is None:
        return None
    positions = _positions(surface, region, reach)
    if not positions:
        return None
    poses = _rotations(surface, region, reach, positions)
    coarse = np.array([refine(surface, region, T, COARSE).T_cam_obj for T in poses])
    tau = tolerance_m(surface.diameter_m, float(reach.centre_cam[2]))
    order = np.argsort(-score_all(surface, region, coarse, 1, POSE_SAMPLES, tau), kind="stable")
    finalists = _different(coarse[order], surface, FINALISTS, 0.5 * DIFFERENT_TURN, 0.03)
    fine = [refine(surface, region, T, FINE).T_cam_obj for T in finalists]
    totals = [score(surface, region, T).total for T in fine]
    best = int(np.argmax(totals))
    return fine[best], totals[best]


def _region(surface: TrackedSurface, frame: RgbdFrame, reach: Reach) -> Region | None:
    """The window that may hold the object."""
    z = float(reach.centre_cam[2])
    if z < 0.05:
        return None
    u, v = frame.camera.project(reach.centre_cam)
    extent = reach.distance_m + surface.radius_m
    w, h = extent / z * frame.camera.fx, extent / z * frame.camera.fy
    return prepare(frame, Box(float(u) - w, float(v) - h, 2 * w, 2 * h), z)


def _positions(surface: TrackedSurface, region: Region, reach: Reach) -> list[Float64]:
    """Up to POSITIONS centres of the object, best first."""
    camera, depth = region.camera, cv2.medianBlur(region.arrays.depth, 5)
    z = float(reach.centre_cam[2])
    stride = max(4, round(POSITION_STEP * surface.diameter_m / z * camera.fx))
    rows, columns = np.mgrid[stride // 2 : camera.height : stride, stride // 2 : camera.width : stride]
    u, v = columns.ravel(), rows.ravel()
    known = depth[v, u] > 0
    u, v = u[known], v[known]
    rays, distances = camera.rays(np.stack([u, v], 1)), depth[v, u].astype(np.float64)
    poses, centres = [], []
    for R in _turned(reach.rotations, POSITION_TURN, POSITION_TURN):
        at = rays * (distances + _half_depth(surface, R))[:, None]
        for c in at[np.linalg.norm(at - reach.centre_cam, axis=1) < reach.distance_m]:
            poses.append(se3.make(R, c - R @ surface.arrays.centre))
            centres.append(c)
    if not poses:
        return []
    tolerance = 0.15 * surface.diameter_m
    totals = score_all(surface, region, np.array(poses), LEVEL, POSITION_SAMPLES, tolerance)
    out: list[Float64] = []
    for i in np.argsort(-totals, kind="stable"):
        if all(np.linalg.norm(centres[i] - c) > tolerance for c in out):
            out.append(centres[i])
            if len(out) == POSITIONS:
                break
    return out


def _half_depth(surface: TrackedSurface, R: Float64) -> float:
    """How far the surface lies in front of the object's centre as seen along the optical axis."""
    q = (surface.arrays.points[::2] - surface.arrays.centre) @ R.T
    middle = np.hypot(q[:, 0], q[:, 1]) < 0.2 * surface.radius_m
    return float(-np.percentile(q[middle, 2], 5)) if middle.any() else 0.5 * surface.radius_m


def _rotations(
    surface: TrackedSurface, region: Region, reach: Reach, positions: list[Float64]
) -> list[Float64]:
    """The best clearly different poses over all rotations in reach at the positions."""
    poses = np.array(
        [
            se3.make(R, c - R @ surface.arrays.centre)
            for R in _turned(reach.rotations, ROTATION_STEP, reach.angle_rad)
            for c in positions
        ]
    )
    totals = score_all(surface, region, poses, LEVEL, ROTATION_SAMPLES, 0.1 * surface.diameter_m)
    return _different(poses[np.argsort(-totals, kind="stable")], surface, POSES, DIFFERENT_TURN, 0.1)


def _different(
    poses: Float64, surface: TrackedSurface, count: int, turn_rad: float, shift: float
) -> list[Float64]:
    """The first `count` poses that differ from those before by the turn, or by `shift` diameters."""
    out = np.empty((count, 4, 4))
    n = 0
    for T in poses:
        cosines = (np.einsum("kij,ij->k", out[:n, :3, :3], T[:3, :3]) - 1.0) / 2.0
        shifts = np.linalg.norm(out[:n, :3, 3] - T[:3, 3], axis=1)
        if ((cosines < np.cos(turn_rad)) | (shifts > shift * surface.diameter_m)).all():
            out[n] = T
            n += 1
            if n == count:
                break
    return list(out[:n])


def _turned(rotations: tuple[Float64, ...], step_rad: float, limit_rad: float) -> list[Float64]:
    """Rotations on shells of `step_rad` about the given ones, up to `limit_rad` (rounded to whole shells)."""
    shells = max(1, round(limit_rad / step_rad))
    return [turn @ R for R in rotations for turn in _ball(round(float(step_rad), 6), shells)]


@lru_cache(maxsize=32)
def _ball(step_rad: float, shells: int) -> tuple[Float64, ...]:
    """The identity and rotations by 1 to `shells` steps about evenly spread axes, some one step apart."""
    out = [np.eye(3)]
    for k in range(1, shells + 1):
        axes = icosphere.directions(0 if k == 1 else 1 if k <= 3 else 2)
        out += [se3.rotation_exp(axis * (k * step_rad)) for axis in axes]
    return tuple(out)
