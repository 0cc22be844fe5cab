"""The tracker's own search in the current frame, for motions that no local method bridges.

At every fifth frame of a fast hand an object rotates by up to 60 degrees and moves by its own length. No
pixel of it is where it was, but the model's colours and the depth are the same. Positions come first (a grid
over the image, at the measured depth, for a few rotations), then rotations at the best positions, then short
refinements of the best poses. Each stage is sorted by the score of few samples at a coarse texture level.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAR_M
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.suppression import first_different
from huepose.judge.kernel_arrays import RegionArrays
from huepose.judge.open_region import OpenRegion, PreparedSurface, open_region, totals
from huepose.judge.terms import score_arrays
from huepose.propose.hue_map import averaged, hue_map
from huepose.refine.photometric import COARSE, FINE, QUICK, refine, refine_all
from huepose.tracking.motion import Reach

POSITION_SAMPLES, ROTATION_SAMPLES, POSE_SAMPLES = 60, 100, 250
"""Surface samples for rating positions, rotations and refined poses: the fewer candidates are left, the more
samples."""

POSITION_STEP = 0.12
"""Spacing of the tried positions, in diameters; for a thin object half its thickness if that is less."""

POSITION_TURN = np.radians(40.0)
"""Positions are scored with the expected rotations and with rotations of this angle around them."""

HUE, HUE_SIDE, HUE_STEP = 0.5, 0.7, 2
"""Weight of the object's hues at a position, whatever its rotation (log-likelihood ratio); side of the square
over which they are averaged, as a share of the object's thickness; step in pixels along each axis at which
they are computed."""

ROTATION_STEP, WIDE_STEP = np.radians(18.0), np.radians(25.0)
WIDE = np.radians(80.0)
"""Spacing of the tried rotations; the wider one if more than WIDE is within reach."""

DIFFERENT_TURN = np.radians(10.0)
"""Candidates closer than this, and than 0.05 diameters, count as one."""

FINAL_SAMPLES = 400
"""Surface samples for rating the finalists."""

FOUND, APART_TURN, APART = 2, np.radians(25.0), 0.15
"""Number of poses returned; they differ by more than APART_TURN or by APART diameters."""


@dataclass(frozen=True)
class Beam:
    """How many candidates each stage of a search keeps: positions, poses refined quickly, poses refined,
    finalists."""

    positions: int
    quick: int
    poses: int
    finalists: int

    def share(self, parts: int, of: int) -> Beam:
        """The same for `parts` of `of` parts of the rotations. Each part tries all positions."""
        return Beam(self.positions, *(-(-n * parts // of) for n in (self.quick, self.poses, self.finalists)))


SMALL_BEAM = Beam(2, 24, 6, 2)
"""If position and rotation are known roughly."""

NORMAL_BEAM = Beam(5, 80, 20, 4)
"""Near the expected position."""

GREAT_BEAM = Beam(8, 250, 40, 6)
"""At any position that the object can have reached."""

PARTS = 10
"""Number of parts that a wide search can be split into."""


def is_wide(reach: Reach) -> bool:
    """Whether so many rotations are in reach that a search through all of them takes several frames."""
    return bool(reach.angle_rad > WIDE)


def parts_a_try(reach: Reach, long: bool) -> int:
    """How many parts of a wide search one costly proposal pays for. long: there is time for several parts,
    which are made together and share the preparation of the image."""
    return 1 if is_wide(reach) and not long else 2


def search(
    surface: PreparedSurface,
    frame: RgbdFrame,
    reach: Reach,
    beam: Beam = NORMAL_BEAM,
    light: Float64 | None = None,
    parts: range = range(PARTS),
) -> list[Float64]:
    """The best clearly different poses (4, 4) within reach, best first, at most two; none without any depth.
    parts: which of the PARTS of the rotations are tried; each is spread over all of the reach."""
    beam = beam.share(len(parts), PARTS)
    region = _region(surface, frame, reach)
    if region is None:
        return []
    region = region.lit(light)
    z = float(reach.centre_cam[2])
    tolerance = region.arrays.tolerance
    positions = _positions(surface, region, reach, beam.positions, parts)
    if not positions:
        return []
    poses = _rotations(surface, region, reach, positions, beam.quick, parts)
    poses = refine_all(surface, region, poses, QUICK, z)
    poses = _best(surface, region, poses, ROTATION_SAMPLES, 2.0 * tolerance, beam.poses, DIFFERENT_TURN)
    poses = refine_all(surface, region, poses, COARSE, z)
    poses = _best(surface, region, poses, POSE_SAMPLES, tolerance, beam.finalists, 0.5 * DIFFERENT_TURN)
    fine = np.array([refine(surface, region, T, FINE).T_cam_obj for T in poses])
    arrays = region.arrays
    rated = score_arrays(surface.arrays, arrays, fine, FINAL_SAMPLES)[:, 0]
    order = np.argsort(-rated, kind="stable")
    kept = first_different(fine[order], APART_TURN, FOUND, APART * surface.diameter_m)
    return list(fine[order][kept])


def _region(surface: PreparedSurface, frame: RgbdFrame, reach: Reach) -> OpenRegion | None:
    """The window of the frame that may show the object."""
    z = float(reach.centre_cam[2])
    if z < NEAR_M:
        return None
    u, v = frame.camera.project(reach.centre_cam)
    extent = reach.distance_m + surface.radius_m
    w, h = extent / z * frame.camera.fx, extent / z * frame.camera.fy
    box = Box(float(u) - w, float(v) - h, 2 * w, 2 * h)
    return open_region(frame, box, z, surface.diameter_m)


def _positions(
    surface: PreparedSurface, region: OpenRegion, reach: Reach, count: int, parts: range
) -> list[Float64]:
    """Up to `count` centres of the object, best first: the middle of its surface is put on a grid of pixels,
    at the measured depth."""
    camera, depth = region.camera, cv2.medianBlur(region.arrays.depth, 5)
    z = float(reach.centre_cam[2])
    step_m = min(POSITION_STEP * surface.diameter_m, max(0.5 * surface.thickness_m, 0.006))
    stride = max(4, round(step_m / z * camera.fx))
    rows, columns = np.mgrid[stride // 2 : camera.height : stride, stride // 2 : camera.width : stride]
    u, v = columns.ravel(), rows.ravel()
    known = depth[v, u] > 0
    u, v = u[known], v[known]
    seen = camera.rays(np.stack([u, v], 1)) * depth[v, u].astype(np.float64)[:, None]
    own = _hues(surface, region.arrays, HUE_SIDE * surface.thickness_m / z * camera.fx)
    poses, centres, hues = [], [], []
    for R in _some(_turned(reach.rotations, POSITION_TURN, POSITION_TURN), parts):
        at = seen + R @ (surface.arrays.centre - _middle(surface, R))
        within = np.linalg.norm(at - reach.centre_cam, axis=1) < reach.distance_m
        poses.append(_at(surface, R, at[within]))
        centres.append(at[within])
        hues.append(own[v[within] // HUE_STEP, u[within] // HUE_STEP])
    if not any(len(few) for few in poses):
        return []
    tolerance = 0.15 * surface.diameter_m
    rated = totals(surface, region, np.concatenate(poses), POSITION_SAMPLES, tolerance)
    left = np.concatenate(centres)[np.argsort(-rated - HUE * np.concatenate(hues), kind="stable")]
    out: list[Float64] = []
    while len(left) and len(out) < count:
        out.append(left[0])
        left = left[np.linalg.norm(left - left[0], axis=1) > tolerance]
    return out


def _hues(surface: PreparedSurface, arrays: RegionArrays, side_px: float) -> Float32:
    """How typical the hues around a pixel are of the object (h, w), at every HUE_STEP-th pixel."""
    some = np.s_[::HUE_STEP, ::HUE_STEP]
    fewer = arrays._replace(
        colors=arrays.colors[(slice(None), *some)], depth=arrays.depth[some], saturated=arrays.saturated[some]
    )
    return averaged(hue_map(surface.arrays, fewer), side_px / HUE_STEP)


def _middle(surface: PreparedSurface, R: Float64) -> Float64:
    """The visible surface point (3,) closest to the object's centre in the image, object axes. The centre
    itself may lie in a hole."""
    a = surface.arrays
    view = int(np.argmax(a.directions @ -R[2]))
    seen = a.visible[a.offsets[view] : a.offsets[view + 1]]
    if not len(seen):
        return a.centre
    lateral = (a.points[seen] - a.centre) @ R[:2].T
    return np.asarray(a.points[seen[int(np.argmin((lateral**2).sum(1)))]], np.float64)


def _rotations(
    surface: PreparedSurface,
    region: OpenRegion,
    reach: Reach,
    positions: list[Float64],
    count: int,
    parts: range,
) -> Float64:
    """The best clearly different poses over these parts of the rotations in reach at the positions."""
    centres = np.array(positions)
    poses = np.concatenate([_at(surface, R, centres) for R in _some(_in_reach(reach), parts)])
    return _best(surface, region, poses, ROTATION_SAMPLES, 0.1 * surface.diameter_m, count, DIFFERENT_TURN)


def _at(surface: PreparedSurface, R: Float64, centres: Float64) -> Float64:
    """Poses (K, 4, 4) of one rotation with the object's centre at each of `centres` (K, 3)."""
    poses = np.zeros((len(centres), 4, 4))
    poses[:, :3, :3], poses[:, 3, 3] = R, 1.0
    poses[:, :3, 3] = centres - R @ surface.arrays.centre
    return poses


def _some(rotations: list[Float64], parts: range) -> list[Float64]:
    """The rotations of these parts."""
    return [R for k, R in enumerate(rotations) if k % PARTS in parts]


def _in_reach(reach: Reach) -> list[Float64]:
    """Rotations (3, 3) within reach, evenly."""
    if not is_wide(reach):
        return _turned(reach.rotations, ROTATION_STEP, reach.angle_rad)
    return _turned(reach.rotations[-1:], WIDE_STEP, reach.angle_rad)


def _best(
    surface: PreparedSurface,
    region: OpenRegion,
    poses: Float64,
    samples: int,
    tolerance_m: float,
    count: int,
    turn_rad: float,
) -> Float64:
    """The `count` best poses that differ by `turn_rad`, or by a twentieth of the diameter."""
    order = np.argsort(-totals(surface, region, poses, samples, tolerance_m), kind="stable")
    kept = first_different(poses[order], turn_rad, count, 0.05 * surface.diameter_m)
    return np.ascontiguousarray(poses[order][kept])


def _turned(rotations: tuple[Float64, ...], step_rad: float, limit_rad: float) -> list[Float64]:
    """Rotations on shells of `step_rad` about the given ones, up to `limit_rad` (rounded to whole shells);
    where two of these overlap, those of the first are kept."""
    shells = max(1, round(limit_rad / step_rad))
    ball = np.array(_ball(round(float(step_rad), 6), shells))
    turned = np.zeros((len(rotations) * len(ball), 4, 4))
    turned[:, :3, :3] = np.concatenate([ball @ R for R in rotations])
    if len(rotations) == 1:
        return list(turned[:, :3, :3])
    return list(turned[first_different(turned, 0.5 * step_rad, len(turned)), :3, :3])


@lru_cache(maxsize=32)
def _ball(step_rad: float, shells: int) -> tuple[Float64, ...]:
    """The identity and rotations by 1 to `shells` steps about evenly spread axes, some one step apart."""
    out = [np.eye(3)]
    for k in range(1, shells + 1):
        axes = icosphere.directions(0 if k == 1 else 1 if k <= 3 else 2)
        out += [se3.rotation_exp(axis * (k * step_rad)) for axis in axes]
    return tuple(out)
