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
from huepose.geometry.arrays import Float64, Int64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.support.jit import jit
from huepose.tracking.reach import Reach
from huepose.tracking.refinement import COARSE, FINE, QUICK, refine, refine_all
from huepose.tracking.region import Region, prepare
from huepose.tracking.scoring import UNKNOWN_TINT, Tint, score, score_all, tolerance_m
from huepose.tracking.surface import TrackedSurface

POSITION_SAMPLES, ROTATION_SAMPLES, POSE_SAMPLES = 60, 100, 250
POSITION_STEP = 0.12
"""Spacing of the tried positions, in diameters; at thin objects half their thickness if that is less."""

POSITION_TURN = np.radians(40.0)
"""Positions are tried with the expected rotations and these far turns of them."""

ROTATION_STEP = np.radians(18.0)
DIFFERENT_TURN = np.radians(10.0)
LEVEL = 2
"""Coarse colours have the widest basins."""


@dataclass(frozen=True)
class Effort:
    """How many positions, poses that are refined quickly, poses that are refined, and finalists are kept."""

    positions: int
    quick: int
    poses: int
    finalists: int


USUAL_EFFORT = Effort(5, 80, 20, 4)
GREAT_EFFORT = Effort(8, 250, 40, 6)


def search(
    surface: TrackedSurface,
    frame: RgbdFrame,
    reach: Reach,
    effort: Effort = USUAL_EFFORT,
    tint: Tint = UNKNOWN_TINT,
) -> tuple[Float64, float] | None:
    """The best pose (4, 4) within reach and its score at the fine texture level; None when no depth is
    there."""
    region = _region(surface, frame, reach)
    if region is None:
        return None
    z = float(reach.centre_cam[2])
    tau = tolerance_m(surface.diameter_m, z)
    positions = _positions(surface, region, reach, effort.positions, tint)
    if not positions:
        return None
    poses = _rotations(surface, region, reach, positions, effort.quick, tint)
    poses = refine_all(surface, region, poses, QUICK, z)
    poses = _best(
        surface, region, poses, LEVEL, ROTATION_SAMPLES, 2.0 * tau, effort.poses, DIFFERENT_TURN, tint
    )
    poses = refine_all(surface, region, poses, COARSE, z)
    poses = _best(surface, region, poses, 1, POSE_SAMPLES, tau, effort.finalists, 0.5 * DIFFERENT_TURN, tint)
    fine = [refine(surface, region, T, FINE).T_cam_obj for T in poses]
    totals = [score(surface, region, T, 0, tint=tint).total for T in fine]
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


def _positions(
    surface: TrackedSurface, region: Region, reach: Reach, count: int, tint: Tint
) -> list[Float64]:
    """Up to `count` centres of the object, best first: the middle of its surface is put on a grid of pixels,
    at the depth that is there."""
    camera, depth = region.camera, cv2.medianBlur(region.arrays.depth, 5)
    z = float(reach.centre_cam[2])
    step_m = min(POSITION_STEP * surface.diameter_m, max(0.5 * surface.thickness_m, 0.006))
    stride = max(4, round(step_m / z * camera.fx))
    rows, columns = np.mgrid[stride // 2 : camera.height : stride, stride // 2 : camera.width : stride]
    u, v = columns.ravel(), rows.ravel()
    known = depth[v, u] > 0
    u, v = u[known], v[known]
    seen = camera.rays(np.stack([u, v], 1)) * depth[v, u].astype(np.float64)[:, None]
    poses, centres = [], []
    for R in _turned(reach.rotations, POSITION_TURN, POSITION_TURN):
        at = seen + R @ (surface.arrays.centre - _middle(surface, R))
        for c in at[np.linalg.norm(at - reach.centre_cam, axis=1) < reach.distance_m]:
            poses.append(se3.make(R, c - R @ surface.arrays.centre))
            centres.append(c)
    if not poses:
        return []
    tolerance = 0.15 * surface.diameter_m
    totals = score_all(surface, region, np.array(poses), LEVEL, POSITION_SAMPLES, tolerance, tint)
    out: list[Float64] = []
    for i in np.argsort(-totals, kind="stable"):
        if all(np.linalg.norm(centres[i] - c) > tolerance for c in out):
            out.append(centres[i])
            if len(out) == count:
                break
    return out


def _middle(surface: TrackedSurface, R: Float64) -> Float64:
    """The point (3,) of the surface that is seen nearest to the object's centre, object axes. The centre
    itself may lie in a hole."""
    a = surface.arrays
    view = int(np.argmax(a.directions @ -R[2]))
    seen = a.visible[a.offsets[view] : a.offsets[view + 1]]
    if not len(seen):
        return a.centre
    lateral = (a.points[seen] - a.centre) @ R[:2].T
    return np.asarray(a.points[seen[int(np.argmin((lateral**2).sum(1)))]], np.float64)


def _rotations(
    surface: TrackedSurface, region: Region, reach: Reach, positions: list[Float64], count: int, tint: Tint
) -> Float64:
    """The best clearly different poses over all rotations in reach at the positions."""
    poses = np.array(
        [
            se3.make(R, c - R @ surface.arrays.centre)
            for R in _turned(reach.rotations, ROTATION_STEP, reach.angle_rad)
            for c in positions
        ]
    )
    tolerance = 0.1 * surface.diameter_m
    return _best(surface, region, poses, LEVEL, ROTATION_SAMPLES, tolerance, count, DIFFERENT_TURN, tint)


def _best(
    surface: TrackedSurface,
    region: Region,
    poses: Float64,
    level: int,
    samples: int,
    tolerance: float,
    count: int,
    turn_rad: float,
    tint: Tint,
) -> Float64:
    """The `count` best poses that differ by the turn, or by a twentieth of the diameter."""
    order = np.argsort(-score_all(surface, region, poses, level, samples, tolerance, tint), kind="stable")
    kept = different(poses[order], float(np.cos(turn_rad)), 0.05 * surface.diameter_m, count)
    return np.ascontiguousarray(poses[order][kept])


@jit
def different(poses: Float64, least_cosine: float, shift: float, count: int) -> Int64:
    """Indices of the first `count` poses that differ from those before by an angle over that of the cosine,
    or by more than `shift` metres."""
    out = np.empty(min(count, poses.shape[0]), np.int64)
    n = 0
    for k in range(poses.shape[0]):
        if n == out.shape[0]:
            break
        alike = False
        for j in range(n):
            P, Q = poses[k], poses[out[j]]
            trace = d2 = 0.0
            for r in range(3):
                d2 += (P[r, 3] - Q[r, 3]) ** 2
                for c in range(3):
                    trace += P[r, c] * Q[r, c]
            if (trace - 1.0) / 2.0 > least_cosine and d2 < shift * shift:
                alike = True
                break
        if not alike:
            out[n] = k
            n += 1
    return out[:n]


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
