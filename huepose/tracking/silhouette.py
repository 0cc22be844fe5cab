"""An object's outline at a pose: which pixels it covers, and how much of the outline two poses share."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.mesh import Mesh
from huepose.rendering.render import render_depth

VISIBLE_M = 0.01
"""Depth may lie this far from the rendered surface, and this share of the distance, and still be the
object."""

VISIBLE_SHARE = 0.005
COMPARED_PX = 96
"""Outlines are compared at this size: exact enough for a ratio of areas."""


def visible_mask(mesh: Mesh, T_cam_obj: Float64, frame: RgbdFrame, box: Box) -> Bool:
    """Pixels (H, W) of the frame in which the object is seen: rendered there, and confirmed by depth. `box`
    bounds the object; it is clipped to the image."""
    mask = np.zeros(frame.depth.shape, bool)
    rows, columns = box.slices(frame.camera.width, frame.camera.height)
    w, h = columns.stop - columns.start, rows.stop - rows.start
    if w <= 0 or h <= 0:
        return mask
    rendered = render_depth(mesh, T_cam_obj, frame.camera.cropped(columns.start, rows.start, w, h))
    seen = frame.depth[rows, columns]
    near = np.abs(seen - rendered) < VISIBLE_M + VISIBLE_SHARE * rendered
    mask[rows, columns] = (rendered > 0) & (seen > 0) & near
    return mask


def overlap(
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
