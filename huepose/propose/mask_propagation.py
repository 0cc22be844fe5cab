"""An object's mask carried from one frame to the next by optical flow."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Bool
from huepose.propose.flow import Flow


def propagate(mask: Bool, flow: Flow) -> Bool:
    """Warp the mask (H, W) bool of the first frame to the second with the backward flow. False outside the
    flow's window."""
    h, w = flow.consistent.shape
    window = np.s_[flow.y0 : flow.y0 + h, flow.x0 : flow.x0 + w]
    columns, rows = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    came = cv2.remap(
        np.ascontiguousarray(mask[window]).view(np.uint8),
        columns + flow.backward[..., 0],
        rows + flow.backward[..., 1],
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=0,
    )
    out = np.zeros_like(mask)
    out[window] = came > 0
    return out
