"""The segmenter that needs no weights: support plane, depth pieces, and a cut by colour.

Its candidates are judged together by the poses that they lead to, so a wrong one costs time, not the answer.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.perception.color_cut import color_cut
from huepose.perception.depth_pieces import MIN_MASK_PIXELS, cut_pieces, join_pieces
from huepose.perception.support_plane import above_plane, find_support_plane

COLOR_MIN_PIXELS = 60
COLOR_SAME = 0.8
"""A colour cut that agrees with the depth mask by this IoU is no other candidate."""


class DepthSegmenter:
    """Outlines an object in a box from depth, helped by colour. Stateless and deterministic."""

    def segment(self, frame: RgbdFrame, box: Box, diameter_m: float) -> list[Bool]:
        """One to three candidate masks (H, W) of pixels with depth, most likely first; a single mask without
        a pixel when the box holds no depth."""
        masks = depth_masks(frame, box, diameter_m)
        if not masks:
            return [_middle_of(frame, box)]
        cut = color_cut(frame.color, box, masks[0])
        agreed, either = np.count_nonzero(cut & masks[0]), np.count_nonzero(cut | masks[0])
        if np.count_nonzero(cut) > COLOR_MIN_PIXELS and agreed < COLOR_SAME * either:
            masks.append(cut)
        return masks


def depth_masks(frame: RgbdFrame, box: Box, diameter_m: float) -> list[Bool]:
    """The candidates that depth alone gives, best first; empty when nothing stands in the box."""
    if box.clipped(frame.camera.width, frame.camera.height).area < 4:
        return []
    rows, columns = box.grown(0.25, 4.0).slices(frame.camera.width, frame.camera.height)
    depth = np.ascontiguousarray(frame.depth[rows, columns])
    camera = frame.camera.cropped(columns.start, rows.start, depth.shape[1], depth.shape[0])
    local = Box(box.x - columns.start, box.y - rows.start, box.w, box.h)
    plane = find_support_plane(frame.depth, frame.camera, box)
    candidate = above_plane(depth, camera, plane)
    masks = join_pieces(depth, candidate, cut_pieces(depth, candidate, local), local, diameter_m)
    return [_in_frame(mask, frame, rows, columns) for mask in masks]


def _in_frame(mask: Bool, frame: RgbdFrame, rows: slice, columns: slice) -> Bool:
    out = np.zeros(frame.depth.shape, bool)
    out[rows, columns] = mask
    return out


def _middle_of(frame: RgbdFrame, box: Box) -> Bool:
    """The inner half of a box where it has depth: what is left when the object cannot be told from its
    support."""
    out = np.zeros(frame.depth.shape, bool)
    rows, columns = box.grown(-0.25).slices(frame.camera.width, frame.camera.height)
    out[rows, columns] = frame.depth[rows, columns] > 0
    return out if np.count_nonzero(out) >= MIN_MASK_PIXELS else np.zeros_like(out)
