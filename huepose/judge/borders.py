"""Does the object end where its outline says? Evidence that depth and texture inside the outline cannot give.

A plane face fits on every plane. An object differs from a floor in that it ends: beyond its outline there is
something farther away, or of another colour. Contours are rendered once for each view direction; at a pose
some hundred contour points are compared with the frame on both sides (`continued`, `held`).
`continuation_many` tests many poses quickly, by depth alone: where the measured surface continues beyond the
outline, only the object's shape or texture is there, not the object.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from huepose.colorpair.opponents import LOGARITHMS, OPPONENTS
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float32, Float64, Int32, Int64, UInt8
from huepose.geometry.camera import NEAR_M, Camera
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.icosphere import look_at
from huepose.geometry.mesh import Mesh
from huepose.judge.kernel_arrays import ModelArrays, projected, shown_range, tolerance_at
from huepose.judge.open_region import PreparedSurface
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose.support.jit import jit
from huepose.support.kept import kept, once_for_each

SIDE_PX, MOST_SIDE_PX, PIXEL_M = 160, 800, 0.002
"""Smallest and largest side of the rendered images that contours are taken from, pixels. Between these limits
a pixel covers at most PIXEL_M of the object: a contour errs by half a pixel, and is compared within
millimetres."""

SHARE, NOMINAL_DISTANCE = 0.9, 5.0
"""Share of the image's side that the object takes, and distance of the camera in object radii."""

POINTS = 96
"""About this many points per outline, evenly spaced."""

BESIDE_M = np.array([0.004, 0.007, 0.010])
"""Distances from the outline at which both sides are compared: larger than calibration errors, smaller than
the thickness of objects."""

STEP_M, STEP_SIGMAS = 0.006, 3.0
"""Beyond the outline, depth that lies behind the continued surface by more than STEP_M plus STEP_SIGMAS
standard errors of a reading belongs to something else."""

OTHER_COLOR = 12.0
"""Two colours differ if their opponents differ by more than this: half a unit of the natural logarithm."""


UNKNOWN, ENDED, CONTINUES = range(3)
"""Results at a point of an outline: not known, the object ends there, surface and colour continue."""


@dataclass(frozen=True, eq=False)
class Lines:
    """All contours, one view after another. points, out (N, 3): see `Contours`; starts (V + 1,) int64: first
    row of each view."""

    points: Float32
    out: Float32
    starts: Int64


@dataclass(frozen=True, eq=False)
class Contours:
    """Contours of an object by view direction, object axes, metres. points (K, 3) on its surface; out (K, 3):
    unit directions away from the object, perpendicular to the line of sight. digest: of the model."""

    mesh: Mesh
    surface: PreparedSurface
    digest: str | None = None

    @staticmethod
    @once_for_each
    def of(model: ReferenceModel) -> Contours:
        """Contours of a reference model; one object per model, shared by all callers."""
        return Contours(model.mesh, PreparedSurface.of(model), model.digest)

    def at(self, T_cam_obj: Float) -> tuple[Float32, Float32]:
        """Points and outward directions (K, 3) of the view nearest to that of a pose."""
        view, lines = self.surface.view_of(T_cam_obj), self.lines
        here = slice(lines.starts[view], lines.starts[view + 1])
        return lines.points[here], lines.out[here]

    @cached_property
    def lines(self) -> Lines:
        """Contours of all views. The first use computes them (0.2 s; 2 s for an object of a metre) or maps
        them from the cache."""
        return kept(Lines, self.digest, self._rendered)

    def _rendered(self) -> Lines:
        directions = self.surface.arrays.directions
        points, out = zip(*(_contour(self.mesh, self.surface, d) for d in directions), strict=True)
        starts = np.cumsum([0, *(len(p) for p in points)])
        return Lines(np.concatenate(points), np.concatenate(out), starts)


def _contour(mesh: Mesh, surface: PreparedSurface, direction: Float32) -> tuple[Float32, Float32]:
    R = look_at(direction)
    distance = NOMINAL_DISTANCE * surface.radius_m
    T = se3.make(R, np.array([0.0, 0.0, distance]) - R @ surface.arrays.centre)
    side = _side_px(surface.radius_m)
    focal = 0.5 * SHARE * side * (distance - surface.radius_m) / surface.radius_m
    middle = (side - 1) / 2
    camera = Camera(focal, focal, middle, middle, side, side)
    depth = render_depth(mesh, T, camera)
    inside = (depth > 0).astype(np.uint8)
    found, _ = cv2.findContours(inside, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not found:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    pixels = np.concatenate([c[:, 0] for c in found])
    pixels = pixels[:: max(1, len(pixels) // POINTS)]
    # The contour of a hole runs on the object, like the outer one.
    blurred = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 3.0)
    u, v = pixels[:, 0], pixels[:, 1]
    slope = np.stack([blurred[v, u + 1] - blurred[v, u - 1], blurred[v + 1, u] - blurred[v - 1, u]], 1)
    length = np.linalg.norm(slope, axis=1)
    on = (depth[v, u] > 0) & (length > 1e-6)
    out = -slope[on] / length[on][:, None]
    points = camera.backproject(pixels[on].astype(np.float64), depth[v, u][on].astype(np.float64))
    points_obj = (points - T[:3, 3]) @ R
    return points_obj.astype(np.float32), (out @ R[:2]).astype(np.float32)


def _side_px(radius_m: float) -> int:
    """Side of the rendered image of an object of that radius, pixels."""
    return int(np.clip(np.ceil(2.0 * radius_m / (SHARE * PIXEL_M)), SIDE_PX, MOST_SIDE_PX))


def continued(contours: Contours, T_cam_obj: Float, frame: RgbdFrame) -> float:
    """Share 0..1 of the outline of a pose T_cam_obj (4, 4) beyond which surface and colour continue."""
    results = _compared(contours, T_cam_obj, frame)[2]
    return np.count_nonzero(results == CONTINUES) / max(len(results), 1)


def held(contours: Contours, T_cam_obj: Float, frame: RgbdFrame) -> Float64:
    """Information (6, 6) that the outline gives about a pose (4, 4): about the object's centre, camera axes.

    Where the object ends, its edge may lie anywhere within the smallest of BESIDE_M. The errors along one
    outline are alike, so all its points together count as two readings, one for each direction in the
    image."""
    p, o, results = _compared(contours, T_cam_obj, frame)
    ended = results == ENDED
    if not ended.any():
        return np.zeros((6, 6))
    arms = p[ended] - contours.surface.centre_cam(T_cam_obj)
    rows = np.concatenate([o[ended], np.cross(arms, o[ended])], axis=1)
    return np.asarray(rows.T @ rows * (2.0 / (len(rows) * BESIDE_M[0] ** 2 / 3.0)))


def _compared(contours: Contours, T_cam_obj: Float, frame: RgbdFrame) -> tuple[Float64, Float64, Int32]:
    """Points and outward directions (K, 3) of the outline at a pose, camera axes, and the result at each
    point (K,): UNKNOWN, ENDED or CONTINUES."""
    points, out = contours.at(T_cam_obj)
    p, o, results = np.empty(points.shape), np.empty(points.shape), np.zeros(len(points), np.int32)
    # Images from the bus are read-only. All images are passed as read-only, so the kernel is compiled only
    # once; so the pose is copied.
    color = frame.color.view()
    color.flags.writeable = False
    T = np.array(T_cam_obj, np.float64, order="C")
    _compare(T, points, out, frame.camera.lens, frame.depth, color, p, o, results)
    return p, o, results


@jit
def _compare(
    T: Float64,
    points_obj: Float32,
    out_obj: Float32,
    lens: Float64,
    depth: Float32,
    color: UInt8,
    points: Float64,
    out: Float64,
    results: Int32,
) -> None:
    """Compare an outline at pose `T` with the frame. points_obj, out_obj (K, 3): the outline in object axes;
    lens: fx, fy, cx, cy. Filled in: points, out (K, 3), camera axes, and results (K,), which are UNKNOWN at
    first."""
    away_m = 0.0
    for k in range(len(points)):
        p, o = points_obj[k], out_obj[k]
        for r in range(3):
            points[k, r] = T[r, 0] * p[0] + T[r, 1] * p[1] + T[r, 2] * p[2] + T[r, 3]
            out[k, r] = T[r, 0] * o[0] + T[r, 1] * o[1] + T[r, 2] * o[2]
        away_m += points[k, 2] / len(points)
    allowed = STEP_M + tolerance_at(0.0, STEP_SIGMAS, away_m)
    z = np.empty((2, 3))
    logs = np.empty((2, 3), np.float32)
    for k in range(len(points)):
        known = True
        logs[:] = 0.0
        for side in range(2):
            for n in range(3):
                step = BESIDE_M[n] if side else -BESIDE_M[n]
                q_z = points[k, 2] + step * out[k, 2]
                far = max(q_z, NEAR_M)
                u = int(np.rint((points[k, 0] + step * out[k, 0]) / far * lens[0] + lens[2]))
                v = int(np.rint((points[k, 1] + step * out[k, 1]) / far * lens[1] + lens[3]))
                if u < 0 or v < 0 or u >= depth.shape[1] or v >= depth.shape[0]:
                    known = False
                    continue
                reading = depth[v, u]
                if not (reading > 0.0 and reading < np.inf):
                    known = False
                    continue
                z[side, n] = reading
                for channel in range(3):
                    logs[side, channel] += LOGARITHMS[color[v, u, channel]] / np.float32(3.0)
        if not known:
            continue
        # Continue the surface inside: level and slope of its three readings.
        there = True
        for n in range(3):
            there = there and abs(z[0, n] - points[k, 2]) < 2.0 * allowed
        slope = (z[0, 0] - z[0, 2]) / (BESIDE_M[2] - BESIDE_M[0])
        level = (z[0, 0] + z[0, 1] + z[0, 2]) / 3.0
        middle = (BESIDE_M[0] + BESIDE_M[1] + BESIDE_M[2]) / 3.0
        behind = np.empty(3)
        for n in range(3):
            behind[n] = z[1, n] - level - slope * (middle + BESIDE_M[n])
            there = there and behind[n] > -allowed
        if not there:
            continue
        median = max(min(behind[0], behind[1]), min(max(behind[0], behind[1]), behind[2]))
        other = median > allowed
        for row in range(3):
            change = np.float32(0.0)
            for channel in range(3):
                change += OPPONENTS[row, channel] * (logs[0, channel] - logs[1, channel])
            other = other or abs(change) > OTHER_COLOR
        results[k] = ENDED if other else CONTINUES


SIDE = 20
"""Cells along the longer side of an object's silhouette (`continuation_many`)."""

INNER, OUTER = 1, 2
"""The rim: cells between these two distances outside the silhouette."""

TOLERANCE_M = 0.012
"""Depth within this distance of the silhouette's depth is the same surface; the size of a cell adds to it."""


def continuation_many(
    model: ModelArrays, depth: Float32, clear: Bool, camera: Camera, poses: Float64, samples: int
) -> Float64:
    """Share (M,) of the rim of each pose (M, 4, 4) on which the measured surface continues that of the
    object.

    depth (h, w): metres, 0 = none; clear (h, w): pixels that can show an object at all; samples: largest
    number of surface samples for the silhouette.
    """
    out = np.zeros(len(poses))
    _continue(np.ascontiguousarray(poses), model, clear, depth, camera.lens, samples, out)
    return out


@jit
def _continue(
    poses: Float64,
    model: ModelArrays,
    clear: Bool,
    depth: Float32,
    lens: Float64,
    samples: int,
    out: Float64,
) -> None:
    n = SIDE + 2 * OUTER + 1
    height, width = depth.shape
    inside = np.empty((n, n))
    seen = np.empty((samples, 3))
    for m in range(poses.shape[0]):
        T = poses[m]
        first, last = shown_range(T, model, samples)
        count = 0
        left, top, right, bottom = 1e9, 1e9, -1e9, -1e9
        for k in range(first, last):
            u, v, z = projected(T, model.points, model.visible[k], lens)
            if z < NEAR_M:
                continue
            left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
            seen[count, 0], seen[count, 1], seen[count, 2] = u, v, z
            count += 1
        if count < 8:
            continue
        cell = max((right - left) / SIDE, (bottom - top) / SIDE, 1.0)
        inside[:] = 0.0
        for k in range(count):
            x, y = int((seen[k, 0] - left) / cell) + OUTER, int((seen[k, 1] - top) / cell) + OUTER
            inside[y, x] = seen[k, 2]
        total, on = 1e-9, 0.0
        for y in range(n):
            for x in range(n):
                if inside[y, x] > 0.0 or _within(inside, y, x, INNER) > 0.0:
                    continue
                near = _within(inside, y, x, OUTER)
                if near == 0.0:
                    continue
                u = int(np.floor(left + (x - OUTER + 0.5) * cell + 0.5))
                v = int(np.floor(top + (y - OUTER + 0.5) * cell + 0.5))
                if u < 0 or v < 0 or u >= width or v >= height or depth[v, u] == 0.0:
                    continue
                total += 1.0
                tolerance = TOLERANCE_M + 1.5 * cell * near / lens[0]
                if clear[v, u] and abs(depth[v, u] - near) < tolerance:
                    on += 1.0
        out[m] = on / total


@jit
def _within(inside: Float64, y: int, x: int, reach: int) -> float:
    """The value of the first cell of (n, n), row by row, that is over 0 and at most `reach` rows and columns
    away; 0 if there is none."""
    n = inside.shape[0]
    for b in range(max(y - reach, 0), min(y + reach + 1, n)):
        for a in range(max(x - reach, 0), min(x + reach + 1, n)):
            if inside[b, a] > 0.0:
                return float(inside[b, a])
    return 0.0
