"""What a pose says of the picture: the pixels that show the object."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float, Float32
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth


def projected_box(model: ReferenceModel, frame: RgbdFrame, T_cam_obj: Float) -> Box | None:
    """Bounds of the object's silhouette, occlusion ignored, clipped to the image; None outside of it."""
    points = model.surface.points @ T_cam_obj[:3, :3].T + T_cam_obj[:3, 3]
    ahead = points[points[:, 2] > 0.05]
    if not len(ahead):
        return None
    box = Box.of_pixels(frame.camera.project(ahead)).clipped(frame.camera.width, frame.camera.height)
    return box if box.area > 0 else None


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
    """Pixels (H, W) of the silhouette where depth agrees with the surface within `tolerance_m`, or where
    there is no reading next to such pixels."""
    out = np.zeros(frame.depth.shape, bool)
    seen = silhouette(model, frame, T_cam_obj)
    if seen is None:
        return out
    rendered, rows, columns = seen
    depth = frame.depth[rows, columns]
    inside = rendered > 0
    agrees = inside & (depth > 0) & (np.abs(depth - rendered) < tolerance_m)
    near = cv2.dilate(agrees.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    out[rows, columns] = agrees | (inside & (depth == 0) & near)
    return out
