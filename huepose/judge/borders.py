"""Does the object end where its outline says? The evidence that depth and print inside of it cannot give.

A plain face fits on every plane. What tells it from a floor is that it ends: beyond the outline there is
something farther away, or of another colour. Contours are rendered once for each direction of view, when it
is first asked for; at a pose some hundred of their points are looked at, on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.geometry import Camera, se3
from huepose.geometry.arrays import Float, Float32, Float64
from huepose.geometry.depth_noise import depth_noise_m
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.mesh import Mesh
from huepose.judge.surface import PreparedSurface
from huepose.rendering.render import render_depth

SIDE_PX, NOMINAL_DISTANCE = 160, 5.0
"""Contours are taken from pictures of that size, from that many radii away."""

POINTS = 96
BESIDE_M = np.array([0.004, 0.007, 0.010])
"""Where both sides of the outline are looked at: farther than calibration errs, nearer than things are
thick."""

STEP_M, STEP_SIGMAS = 0.006, 3.0
"""What lies this much behind the continued surface, and so many errors of a reading, is something else."""

OTHER_COLOR = 12.0
"""Difference of opponents from which on it is another colour: half a natural logarithm."""


@dataclass(frozen=True)
class Outline:
    """Shares of an outline, 0..1, that together are at most 1: ended: there is something farther away or of
    another colour beyond; goes_on: surface and colour go on. The rest is hidden, out of the image or unknown,
    or the surface is not there."""

    ended: float
    goes_on: float


NO_OUTLINE = Outline(0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Contours:
    """Contours of an object by direction of view: points (K, 3) on its surface and unit directions (K, 3)
    that lead away from it across the line of sight, object axes."""

    mesh: Mesh
    surface: PreparedSurface
    _known: dict[int, tuple[Float32, Float32]] = field(default_factory=dict)

    def at(self, T_cam_obj: Float) -> tuple[Float32, Float32]:
        """Of the view that is nearest to that of a pose."""
        eye = T_cam_obj[:3, :3].T @ -self.surface.centre_cam(T_cam_obj)
        view = int(np.argmax(self.surface.arrays.directions @ eye.astype(np.float32)))
        if view not in self._known:
            self._known[view] = _contour(self.mesh, self.surface, self.surface.arrays.directions[view])
        return self._known[view]


def _contour(mesh: Mesh, surface: PreparedSurface, direction: Float32) -> tuple[Float32, Float32]:
    away = -direction.astype(np.float64)
    x = np.cross(away, np.eye(3)[int(np.argmin(np.abs(away)))])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(away, x), away])
    distance = NOMINAL_DISTANCE * surface.radius_m
    T = se3.make(R, np.array([0.0, 0.0, distance]) - R @ surface.arrays.centre)
    focal = 0.45 * SIDE_PX * (distance - surface.radius_m) / surface.radius_m
    middle = (SIDE_PX - 1) / 2
    camera = Camera(focal, focal, middle, middle, SIDE_PX, SIDE_PX)
    depth = render_depth(mesh, T, camera)
    inside = (depth > 0).astype(np.uint8)
    found, _ = cv2.findContours(inside, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not found:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    pixels = np.concatenate([c[:, 0] for c in found])
    pixels = pixels[:: max(1, len(pixels) // POINTS)]
    # The contour of a hole runs outside of it, on the object, as that around the object does.
    blurred = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 3.0)
    u, v = pixels[:, 0], pixels[:, 1]
    slope = np.stack(
        [cv2.Sobel(blurred, cv2.CV_32F, 1, 0)[v, u], cv2.Sobel(blurred, cv2.CV_32F, 0, 1)[v, u]], 1
    )
    length = np.linalg.norm(slope, axis=1)
    on = (depth[v, u] > 0) & (length > 1e-6)
    out = -slope[on] / length[on][:, None]
    points = camera.backproject(pixels[on].astype(np.float64), depth[v, u][on].astype(np.float64))
    points_obj = (points - T[:3, 3]) @ R
    return points_obj.astype(np.float32), (out @ R[:2]).astype(np.float32)


def outline(contours: Contours, T_cam_obj: Float, frame: RgbdFrame) -> Outline:
    """Look along the outline of a pose (4, 4)."""
    points, out = contours.at(T_cam_obj)
    if not len(points):
        return NO_OUTLINE
    R, camera = T_cam_obj[:3, :3], frame.camera
    p, o = points @ R.T + T_cam_obj[:3, 3], out @ R.T
    inner, outer = (p[:, None] + s * BESIDE_M[None, :, None] * o[:, None] for s in (-1.0, 1.0))
    z_in, color_in, known_in = _read(frame, camera, inner)
    z_out, color_out, known_out = _read(frame, camera, outer)
    allowed = STEP_M + STEP_SIGMAS * depth_noise_m(float(p[:, 2].mean()))
    # Continued by what was measured inside: level and slope, as far as three readings tell them.
    there = known_in.all(1) & (np.abs(z_in - p[:, 2:3]) < 2.0 * allowed).all(1)
    slope = (z_in[:, 0] - z_in[:, 2]) / (BESIDE_M[2] - BESIDE_M[0])
    going_on = z_in.mean(1)[:, None] + slope[:, None] * (BESIDE_M.mean() + BESIDE_M)[None]
    behind = z_out - going_on
    seen = there & known_out.all(1) & (behind > -allowed).all(1)
    farther = seen & (np.median(behind, 1) > allowed)
    other = seen & (np.abs(color_in - color_out).max(1) > OTHER_COLOR)
    ended = farther | other
    return Outline(float(ended.mean()), float((seen & ~ended).mean()))


def _read(frame: RgbdFrame, camera: Camera, points: Float64) -> tuple[Float64, Float32, np.ndarray]:
    """Depth (K, N), mean opponents (K, 3) and which readings there are (K, N) at points (K, N, 3)."""
    z = np.maximum(points[..., 2], 0.05)
    u = np.rint(points[..., 0] / z * camera.fx + camera.cx).astype(np.int64)
    v = np.rint(points[..., 1] / z * camera.fy + camera.cy).astype(np.int64)
    within = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    u, v = np.clip(u, 0, camera.width - 1), np.clip(v, 0, camera.height - 1)
    depth = np.nan_to_num(frame.depth[v, u].astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    color = opponents_of_bytes(np.ascontiguousarray(frame.color[v, u])).mean(1)
    return depth, color, within & (depth > 0.0)
