"""Aligns rough poses with the depth: point-to-plane ICP with the points inside a sphere around each pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.camera import NEAR_M
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView
from huepose.refine.point_to_plane import (
    NO_REPORTS,
    Gates,
    Reports,
    ScenePoints,
    SurfaceArrays,
    align_kernel,
    grid_body,
    surface_arrays,
)
from huepose.refine.solver import Body
from huepose.support.jit import jit

POINTS, ITERATIONS = 150, 10
"""Depth readings to use in a sphere, about (at most four times as many), and steps of ICP."""

GATE_START, GATE_END_M = 0.15, 0.012
"""Correspondence gate: at the start in diameters, at the end in metres."""

REACH = 0.55
"""Radius of the sphere around the object's centre, in diameters."""


class _View(NamedTuple):
    """Depth (h, w) in metres, mask (h, w) of what is clear of planes, and fx, fy, cx, cy of the camera."""

    depth: Float32
    clear: Bool
    camera: Float64


def align_in_view(model: ReferenceModel, view: ClearView, poses: Float64) -> Float64:
    """Poses (M, 4, 4) after robust point-to-plane ICP with the clear points around each of them."""
    out = np.array(poses)
    _align(
        out,
        _View(view.crop.depth, view.clear, view.crop.camera.lens),
        surface_arrays(model.surface, model.grid),
        grid_body(model.grid),
        Body(model.mesh.centre, REACH * model.diameter_m),
        Gates(GATE_START * model.diameter_m, GATE_END_M, ITERATIONS),
        NO_REPORTS,
    )
    return out


@jit
def _align(
    poses: Float64,
    view: _View,
    surface: SurfaceArrays,
    body: Body,
    sphere: Body,
    gates: Gates,
    reports: Reports,
) -> None:
    points, weights = np.empty((4 * POINTS, 3)), np.ones(4 * POINTS)
    for m in range(poses.shape[0]):
        T = poses[m]
        x, y, z = T[0, 3], T[1, 3], T[2, 3]
        for c in range(3):
            x += T[0, c] * sphere.centre[c]
            y += T[1, c] * sphere.centre[c]
            z += T[2, c] * sphere.centre[c]
        if z < NEAR_M:
            continue
        count = points_around(x, y, z, sphere.radius, view, points)
        if count < 10:
            continue
        scene = ScenePoints(points[:count], weights[:count])
        align_kernel(poses[m : m + 1], scene, surface, body, gates, reports)


@jit
def points_around(x: float, y: float, z: float, reach: float, view: _View, points: Float64) -> int:
    """Fill `points` (N, 3) with clear points within `reach` metres of (x, y, z); returns their number."""
    depth, clear, camera = view.depth, view.clear, view.camera
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    height, width = depth.shape
    u, v, r = x / z * fx + cx, y / z * fy + cy, reach / z * fx
    step = max(1, int(np.sqrt(4.0 * r * r / (2.5 * POINTS))))
    count = 0
    for b in range(max(0, int(v - r)), min(height, int(v + r) + 1), step):
        for a in range(max(0, int(u - r)), min(width, int(u + r) + 1), step):
            d = depth[b, a]
            if not clear[b, a]:
                continue
            px, py = (a - cx) / fx * d, (b - cy) / fy * d
            away = (px - x) ** 2 + (py - y) ** 2 + (d - z) ** 2
            if away < reach * reach and count < points.shape[0]:
                points[count, 0], points[count, 1], points[count, 2] = px, py, d
                count += 1
    return count
