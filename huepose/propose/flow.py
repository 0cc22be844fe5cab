"""Dense optical flow between two frames, only in the object's region, checked forward and backward.

DIS flow (Kroeger et al. 2016, OpenCV) needs no network and costs about a millisecond on 240 x 240 pixels;
its patches are normalised for brightness. A network's flow can replace it (`perception.flow_network`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float, Float32, Float64, UInt8
from huepose.geometry.box import Box
from huepose.support.jit import jit

MIN_SIDE = 32
"""DIS needs a few patches at its coarsest scale."""

MAX_ERROR_PX = 1.0
MAX_ERROR_SHARE = 0.05
"""Flow is consistent if forward plus backward flow misses the start by less than this many pixels plus this
share of its length."""


@dataclass(frozen=True, eq=False)
class Flow:
    """Flow in a window of two frames whose corner is pixel (x0, y0).

    forward (H, W, 2) float32: where pixels of the first frame go (du, dv); backward (H, W, 2): where pixels
    of the second came from; consistent (H, W) bool: forward flow that the backward flow confirms.
    """

    forward: Float32
    backward: Float32
    consistent: Bool
    x0: int
    y0: int

    def at(self, pixels: Float) -> tuple[Float64, Bool]:
        """Flow (N, 2) of frame pixels (N, 2), bilinear, and whether it is consistent there (N,)."""
        local = np.asarray(pixels, np.float32) - np.array([self.x0, self.y0], np.float32)
        h, w = self.consistent.shape
        u, v = local[:, 0], local[:, 1]
        inside = (u >= 0) & (v >= 0) & (u <= w - 1) & (v <= h - 1)
        moved = sampled(self.forward, local)
        columns, rows = np.clip(np.rint(u), 0, w - 1).astype(int), np.clip(np.rint(v), 0, h - 1).astype(int)
        return moved.astype(np.float64), inside & self.consistent[rows, columns]


class FlowSource(Protocol):
    """Computes optical flow; `compute` is the default, which needs no network."""

    def __call__(self, color_a: UInt8, color_b: UInt8, box: Box) -> Flow | None:
        """Flow from one colour image (H, W, 3) uint8 RGB to another in a window that covers `box` as far as
        the image has room; None if too few pixels are left."""
        ...


def sampled(image: Float32, pixels: Float) -> Float32:
    """Bilinear values (N, C) of a float32 image (H, W, C) at pixels (N, 2); the border continues outwards."""
    p = np.asarray(pixels, np.float32).reshape(1, -1, 2)
    if p.shape[1] == 0:
        return np.zeros((0, image.shape[2]), np.float32)
    # cv2.remap takes at most 32767 columns.
    parts = [
        cv2.remap(image, q[..., 0], q[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for q in np.array_split(p, p.shape[1] // 30000 + 1, axis=1)
    ]
    return np.asarray(np.concatenate(parts, 1).reshape(-1, image.shape[2]), np.float32)


def compute(
    color_a: UInt8, color_b: UInt8, box: Box, preset: int = cv2.DISOPTICAL_FLOW_PRESET_FAST
) -> Flow | None:
    """Flow from one colour image (H, W, 3) uint8 RGB to another inside `box` (clipped to the image); None
    if less than 32 pixels a side are left."""
    rows, columns = box.slices(color_a.shape[1], color_a.shape[0])
    if rows.stop - rows.start < MIN_SIDE or columns.stop - columns.start < MIN_SIDE:
        return None
    a = cv2.cvtColor(color_a[rows, columns], cv2.COLOR_RGB2GRAY)
    b = cv2.cvtColor(color_b[rows, columns], cv2.COLOR_RGB2GRAY)
    dis: Any = cv2.DISOpticalFlow.create(preset)  # its type stubs require a flow to begin with
    forward, backward = (np.asarray(dis.calc(*pair, None), np.float32) for pair in ((a, b), (b, a)))
    return Flow(forward, backward, consistency(forward, backward), columns.start, rows.start)


@jit
def consistency(forward: Float32, backward: Float32) -> Bool:
    """Forward-backward check: (H, W) bool, True where forward (H, W, 2) and backward flow (H, W, 2)
    cancel."""
    h, w = forward.shape[0], forward.shape[1]
    out = np.zeros((h, w), np.bool_)
    for row in range(h):
        for column in range(w):
            du, dv = forward[row, column, 0], forward[row, column, 1]
            u, v = column + du, row + dv
            if u < 0.0 or v < 0.0 or u > w - 1 or v > h - 1:
                continue
            x, y = min(int(u), w - 2), min(int(v), h - 2)
            a, b = u - x, v - y
            miss = 0.0
            for c in range(2):
                top = backward[y, x, c] * (1 - a) + backward[y, x + 1, c] * a
                bottom = backward[y + 1, x, c] * (1 - a) + backward[y + 1, x + 1, c] * a
                miss += ((du if c == 0 else dv) + top * (1 - b) + bottom * b) ** 2
            allowed = MAX_ERROR_PX + MAX_ERROR_SHARE * np.sqrt(du * du + dv * dv)
            out[row, column] = miss < allowed * allowed
    return out
