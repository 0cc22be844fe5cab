"""Visibility of surface points from many directions, by rendered depth images (z-buffer test)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Bool, Float, Float32, Float64, Int32
from huepose.geometry.camera import Camera
from huepose.geometry.mesh import Mesh
from huepose.rendering.render import render_depth
from huepose.support.jit import jit

LEVEL = 3  # 642 directions, 8 degrees apart
_PIXELS = 128  # a side of a view
_DIAMETER_PX = 110.0  # of the object in a view
_DISTANCE = 6.0  # of the camera, diameters: nearly parallel rays
_MIN_COSINE = 0.12  # of the viewing angle at a visible surface
_TOLERANCE_M = 0.0015  # of the depth comparison, beside pixel size and slope

_AT_ONCE = 20_000
"""Points per call of the kernel: a tenth of a second, so that Ctrl-C can act between calls."""


class DepthViews(NamedTuple):
    """Rendered depth images of an object from `directions` (V, 3), at poses `T_cam_obj` (V, 4, 4); depths
    (V, H, W) float32 metres, 0 = nothing; focal, middle: focal length and principal point, the same along
    both axes, pixels; pixel_m: size of a pixel at the object."""

    directions: Float64
    T_cam_obj: Float64
    depths: Float32
    focal: float
    middle: float
    pixel_m: float


def depth_views(mesh: Mesh, diameter_m: float, level: int = LEVEL) -> DepthViews:
    """Depth images of the mesh from all directions of an icosphere; its centre is in the middle of each."""
    directions = icosphere.directions(level)
    distance = _DISTANCE * diameter_m
    focal = _DIAMETER_PX * distance / diameter_m
    middle = (_PIXELS - 1) / 2.0
    camera = Camera(focal, focal, middle, middle, _PIXELS, _PIXELS)
    poses = np.stack([pose_from(d, mesh.centre, distance) for d in directions])
    depths = np.stack([render_depth(mesh, T, camera, near_m=diameter_m) for T in poses])
    return DepthViews(directions, poses, depths, focal, middle, diameter_m / _DIAMETER_PX)


def pose_from(direction: Float, centre: Float, distance_m: float) -> Float64:
    """T_cam_obj (4, 4) of a camera in `direction` (3,) from the object, which looks at `centre` (3,)."""
    R = icosphere.look_at(direction)
    return se3.make(R, np.array([0.0, 0.0, distance_m]) - R @ centre)


def seen(views: DepthViews, points: Float, normals: Float) -> Bool:
    """Visibility (V, N) bool: the point faces the camera and nothing is in front of it.

    points, normals (N, 3): object axes. The depth tolerance grows with pixel size and slope of the surface.
    """
    out = np.zeros((len(views.directions), len(points)), np.bool_)
    _seen(views, np.ascontiguousarray(points, np.float64), np.ascontiguousarray(normals, np.float64), out)
    return out


def votes(views: DepthViews, points: Float, normals: Float, enough: int | None = None) -> Int32:
    """Number of views (N,) in which each point is visible from the side of its normal. A quarter of the
    views is tried first, and all views for points that are visible in none of these. enough: counting stops
    at this number, by default never."""
    most = len(views.directions) if enough is None else enough
    parts = [
        _votes(views, points[first : first + _AT_ONCE], normals[first : first + _AT_ONCE], most)
        for first in range(0, len(points), _AT_ONCE)
    ]
    return np.concatenate(parts) if parts else np.zeros(0, np.int32)


def _votes(views: DepthViews, points: Float, normals: Float, most: int) -> Int32:
    p, n = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(normals, np.float64)
    out = np.zeros(len(points), np.int32)
    coarse = icosphere.directions(LEVEL - 1).shape[0]  # the finer sphere begins with the coarser one
    _count_seen(views, p, n, coarse, most, out)
    unseen = np.flatnonzero(out == 0)
    again = np.zeros(len(unseen), np.int32)
    _count_seen(views, p[unseen], n[unseen], len(views.directions), most, again)
    out[unseen] = again
    return out


@jit
def _is_seen(views: DepthViews, k: int, p: Float64, normal: Float64) -> bool:
    d, T, depth = views.directions[k], views.T_cam_obj[k], views.depths[k]
    cosine = d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2]
    if cosine < _MIN_COSINE:
        return False
    x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
    y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
    z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
    u = int(x / z * views.focal + views.middle + 0.5)
    v = int(y / z * views.focal + views.middle + 0.5)
    if u < 0 or v < 0 or v >= depth.shape[0] or u >= depth.shape[1]:
        return False
    surface = depth[v, u]
    slope = min(np.sqrt(1.0 - min(cosine, 1.0) ** 2) / cosine, 3.0)
    return bool(surface == 0.0 or z < surface + _TOLERANCE_M + 0.75 * views.pixel_m * slope)


@jit
def _seen(views: DepthViews, points: Float64, normals: Float64, out: Bool) -> None:
    for k in range(views.directions.shape[0]):
        for i in range(points.shape[0]):
            out[k, i] = _is_seen(views, k, points[i], normals[i])


@jit
def _count_seen(
    views: DepthViews, points: Float64, normals: Float64, first: int, most: int, out: Int32
) -> None:
    """Add to `out` how many of the first `first` views see each point, at most `most`."""
    for i in range(points.shape[0]):
        for k in range(min(first, views.directions.shape[0])):
            if _is_seen(views, k, points[i], normals[i]):
                out[i] += 1
                if out[i] == most:
                    break
