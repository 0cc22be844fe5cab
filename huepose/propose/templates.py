"""Render view templates: small pictures of an object from all directions, at metric scale. Built once,
offline.

The poses of the templates: `T_cam_obj` of direction v at roll r has the rotation Rz(2 pi r / R) look_at(v)
when the object is on the optical axis, Rz being the turn about the optical axis from x to y (clockwise in the
picture), and the origin lies at Rz(2 pi r / R) `origins[v]` from the point on the axis at the median depth.
"""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Float32
from huepose.geometry.camera import Camera
from huepose.geometry.mesh import Mesh
from huepose.model.types import ViewTemplates
from huepose.rendering.render import render

LEVEL = 2
"""Subdivision level of the icosphere of directions: 162, 16 degrees apart."""
ROLLS = 24
"""Rotations about the line of sight, 15 degrees apart."""
SIDE = 16
"""Cells a side of a template."""
SPAN = 1.1
"""Width of a template in object diameters, at the median depth."""

_OVERSAMPLING = 6
"""Rendered pixels per cell and axis."""
DISTANCE_M, DISTANCE_DIAMETERS = 0.85, 2.5
"""Distance of the rendering camera, the larger of both, so that large objects are not distorted by
perspective."""


def build_templates(
    mesh: Mesh, diameter_m: float, *, level: int = LEVEL, rolls: int = ROLLS
) -> ViewTemplates:
    """Templates of a mesh from all directions of an icosphere of this level, at `rolls` rotations about the
    axis each."""
    directions = icosphere.directions(level)
    planes = np.empty((len(directions), rolls, 5, SIDE, SIDE), np.float16)
    origins = np.empty((len(directions), 3), np.float32)
    window = SIDE * _OVERSAMPLING
    distance = max(DISTANCE_M, DISTANCE_DIAMETERS * diameter_m)
    focal = window * distance / (SPAN * diameter_m)
    camera = Camera(focal, focal, window - 0.5, window - 0.5, 2 * window, 2 * window)
    for v, direction in enumerate(directions):
        R = icosphere.look_at(direction)
        T_cam_obj = se3.make(R, [0.0, 0.0, distance] - R @ mesh.centre)
        rendering = render([(mesh, T_cam_obj)], camera)
        covered = rendering.depth > 0
        rows, columns = np.nonzero(covered)
        centroid = np.array([columns.mean(), rows.mean()])
        median = float(np.median(rendering.depth[covered]))
        origins[v] = T_cam_obj[:3, 3] - camera.backproject(centroid, np.array(median))
        picture = np.zeros((*covered.shape, 5), np.float32)
        lab = cv2.cvtColor(rendering.color.astype(np.float32) / 255.0, cv2.COLOR_RGB2Lab)
        picture[..., :3] = lab * covered[..., None]
        picture[..., 3] = (rendering.depth - median) * covered
        picture[..., 4] = covered
        for r in range(rolls):
            small = _turned(picture, centroid, 2 * np.pi * r / rolls, distance / median, window)
            planes[v, r] = small.transpose(2, 0, 1)
    return ViewTemplates(directions.astype(np.float32), planes, origins, SPAN)


def _turned(picture: Float32, centroid: np.ndarray, angle: float, scale: float, window: int) -> Float32:
    """One template (SIDE, SIDE, 5): the picture (H, W, 5) rotated by `angle` (radians) about `centroid` (2,),
    cut to the window and box-averaged. scale: picture pixels per window pixel. All channels but coverage are
    divided by it."""
    c, s = np.cos(angle), np.sin(angle)
    A = np.array([[c, s], [-s, c]]) * scale  # from the turned window back to the picture
    offset = centroid - A @ np.full(2, (window - 1) / 2.0)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    large = cv2.warpAffine(picture, np.column_stack([A, offset]), (window, window), flags=flags)
    small = cv2.resize(large, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    known = small[..., 4:] > 1e-3
    small[..., :4] = np.where(known, small[..., :4] / np.maximum(small[..., 4:], 1e-3), 0.0)
    small[..., 4:] *= known
    return np.asarray(small, np.float32)
