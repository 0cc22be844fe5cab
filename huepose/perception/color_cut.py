"""A cut by colour inside a depth mask (GrabCut, Rother et al. 2004): where neighbours touch without a depth
step, their colours may still tell them apart."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, UInt8
from huepose.geometry.box import Box

MAX_SIDE = 72
"""The cut runs on a reduced picture of at most this many pixels a side: a tenth of the time, the same
answer."""

ITERATIONS = 4


def color_cut(color: UInt8, box: Box, mask: Bool) -> Bool:
    """The part of a mask (H, W) whose colours (RGB) differ from those outside the box; the mask itself where
    there is nothing to compare."""
    height, width = mask.shape
    rows, columns = box.grown(0.35, 8.0).slices(width, height)
    window = np.ascontiguousarray(color[rows, columns, ::-1])
    inside = mask[rows, columns]
    labels = np.full(inside.shape, cv2.GC_BGD, np.uint8)
    wide = box.grown(0.09)
    y0, x0 = max(0, int(wide.y - rows.start)), max(0, int(wide.x - columns.start))
    labels[y0 : max(0, int(wide.y1 - rows.start)), x0 : max(0, int(wide.x1 - columns.start))] = cv2.GC_PR_BGD
    labels[inside] = cv2.GC_PR_FGD
    h, w = (int(n) for n in inside.shape)
    scale = min(1.0, MAX_SIDE / max(h, w))
    size = (max(2, round(w * scale)), max(2, round(h * scale)))
    small = cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST)
    if not (small == cv2.GC_PR_FGD).any() or not (small == cv2.GC_BGD).any():
        return mask
    try:
        cv2.setRNGSeed(1)
        cv2.grabCut(
            cv2.resize(window, size, interpolation=cv2.INTER_AREA),
            small,
            (0, 0, 0, 0),  # not read with a mask
            np.zeros((1, 65)),
            np.zeros((1, 65)),
            ITERATIONS,
            cv2.GC_INIT_WITH_MASK,
        )
    except cv2.error:
        return mask  # Fewer pixels of one side than colour models.
    kept = (small == cv2.GC_FGD) | (small == cv2.GC_PR_FGD)
    grown = cv2.resize(kept.astype(np.uint8) * 255, (w, h), interpolation=cv2.INTER_LINEAR) >= 128
    cut = cv2.morphologyEx((grown & inside).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    out = np.zeros_like(mask)
    out[rows, columns] = cut > 0
    return out
