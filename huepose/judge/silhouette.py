"""Silhouettes and visible masks of a pose: the pixels that show the object, with and without occlusion."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float32, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAR_M, Camera
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.mesh import Mesh
from huepose.judge.kernel_arrays import tolerance_at
from huepose.judge.region import NOISE_SIGMAS, tolerance_m
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose.support.jit import jit_dividing


def projected_box(model: ReferenceModel, frame: RgbdFrame, T_cam_obj: Float) -> Box | None:
    """Bounds of the object's silhouette, occlusion ignored, clipped to the image; None outside of it."""
    camera = frame.camera
    T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
    ahead, *bounds = bounds_of(model.surface.points, T, camera.fx, camera.fy, camera.cx, camera.cy, NEAR_M)
    if not ahead:
        return None
    left, top, right, bottom = bounds
    box = Box(left, top, right - left + 1.0, bottom - top + 1.0).clipped(camera.width, camera.height)
    return box if box.area > 0 else None


@jit_dividing
def bounds_of(
    points: Float32, T: Float64, fx: float, fy: float, cx: float, cy: float, nearest_m: float
) -> tuple[int, float, float, float, float]:
    """How many of the points (N, 3) lie farther than `nearest_m` ahead of the camera, and left, top, right
    and bottom of their pixels."""
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    ahead = 0
    for k in range(points.shape[0]):
        p0, p1, p2 = points[k, 0], points[k, 1], points[k, 2]
        z = T[2, 0] * p0 + T[2, 1] * p1 + T[2, 2] * p2 + T[2, 3]
        if z < nearest_m:
            continue
        ahead += 1
        u = (T[0, 0] * p0 + T[0, 1] * p1 + T[0, 2] * p2 + T[0, 3]) / z * fx + cx
        v = (T[1, 0] * p0 + T[1, 1] * p1 + T[1, 2] * p2 + T[1, 3]) / z * fy + cy
        left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
    return ahead, left, top, right, bottom


def silhouette(
    model: ReferenceModel, frame: RgbdFrame, T_cam_obj: Float
) -> tuple[Float32, slice, slice] | None:
    """Rendered depth of the object in a window of the frame, and the window; None outside of the image."""
    box = projected_box(model, frame, T_cam_obj)
    if box is None:
        return None
    rows, columns = box.grown(0.0, 3.0).slices(frame.camera.width, frame.camera.height)
    window = frame.camera.cropped(
        columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start
    )
    return render_depth(model.mesh, T_cam_obj, window), rows, columns


def visible_mask(model: ReferenceModel, frame: RgbdFrame, T_cam_obj: Float, tolerance_m: float) -> Bool:
    """Pixels (H, W) of the silhouette where depth agrees with the surface within `tolerance_m` or the noise
    of depth there, or where there is no reading next to such pixels."""
    out = np.zeros(frame.depth.shape, bool)
    seen = silhouette(model, frame, T_cam_obj)
    if seen is None:
        return out
    rendered, rows, columns = seen
    depth = frame.depth[rows, columns]
    inside = rendered > 0
    most = tolerance_at(tolerance_m, NOISE_SIGMAS, _away_m(model, T_cam_obj))
    agrees = inside & (depth > 0) & (np.abs(depth - rendered) < most)
    near = cv2.dilate(agrees.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    out[rows, columns] = agrees | (inside & (depth == 0) & near)
    return out


def _away_m(model: ReferenceModel, T_cam_obj: Float) -> float:
    """Depth of the object's centre, metres. (The origin may lie far from it.)"""
    return float(se3.apply(T_cam_obj, model.mesh.centre[None])[0, 2])


RIM_PX = 5
"""Side of the square, pixels, by which the pixels of instances are dilated: along an outline, colour and
depth mix with the background's."""


def taken_by(model: ReferenceModel, frame: RgbdFrame, poses: Sequence[Float64]) -> Bool:
    """Pixels (H, W) of a frame that instances of an object at poses T_cam_obj (4, 4) explain, dilated by
    RIM_PX."""
    seen = np.zeros(frame.depth.shape, bool)
    for T in poses:
        seen |= visible_mask(model, frame, T, tolerance_m(model.diameter_m, _away_m(model, T)))
    return np.asarray(cv2.dilate(seen.view(np.uint8), np.ones((RIM_PX, RIM_PX), np.uint8)) > 0)


COMPARED_PX = 96
"""Largest side of the images on which silhouettes are compared, pixels: exact enough for a ratio of areas."""


def silhouette_iou(
    mesh: Mesh, T_a: Float64, T_b: Float64, box_a: Box | None, box_b: Box | None, camera: Camera
) -> float:
    """Intersection over union of the outlines at two poses whose boxes are known; 0 where one has none."""
    if box_a is None or box_b is None or box_a.iou(box_b) <= 0.0:
        return 0.0
    x0, y0 = min(box_a.x, box_b.x), min(box_a.y, box_b.y)
    x1, y1 = max(box_a.x1, box_b.x1), max(box_a.y1, box_b.y1)
    factor = min(1.0, COMPARED_PX / max(x1 - x0, y1 - y0))
    window = camera.cropped(int(np.floor(x0)), int(np.floor(y0)), int(x1 - x0) + 2, int(y1 - y0) + 2)
    small = window.scaled(factor)
    a, b = render_depth(mesh, T_a, small) > 0, render_depth(mesh, T_b, small) > 0
    union = int((a | b).sum())
    return int((a & b).sum()) / union if union else 0.0
