"""A cut by colour inside a depth mask: where neighbours touch without a depth step, their colours may still
tell them apart.

Which colours are the object's is learned from the mask, most from its middle, and which are not from what
surrounds the box; both as histograms, and anew from what was kept. A pixel is kept when its neighbourhood is
more likely the object's: the two likelihoods of GrabCut (Rother et al. 2004) with smoothing instead of a
graph, which takes a sixth of the time and gives masks as good.
"""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.geometry.box import Box

MAX_SIDE = 72
"""The cut runs on a reduced picture of at most this many pixels a side."""

BINS = 16
"""Of each channel of CIELAB."""

ROUNDS = 2
SMOOTHING_PX = 1.5
MOST_EVIDENCE = 3.0
"""Log-likelihood ratio that a single pixel can have."""

RARE = 1e-4
"""Added to shares of colours: rarer than this is not known."""

MIDDLE = 0.4
"""Standard deviation of the weight that the middle of the box has, in its sizes."""


def color_cut(color: UInt8, box: Box, mask: Bool) -> Bool:
    """The part of a mask (H, W) whose colours (RGB) differ from those outside the box; the mask itself where
    there is nothing to compare."""
    height, width = mask.shape
    rows, columns = box.grown(0.35, 8.0).slices(width, height)
    inside = mask[rows, columns].astype(np.uint8)
    h, w = inside.shape
    if not h or not w:
        return mask
    scale = min(1.0, MAX_SIDE / max(h, w))
    size = (max(2, round(w * scale)), max(2, round(h * scale)))
    small = cv2.resize(np.ascontiguousarray(color[rows, columns]), size, interpolation=cv2.INTER_AREA)
    covered = cv2.resize(inside, size, interpolation=cv2.INTER_NEAREST) > 0
    v = (rows.start + (np.arange(size[1]) + 0.5) * (h / size[1]))[:, None]
    u = (columns.start + (np.arange(size[0]) + 0.5) * (w / size[0]))[None, :]
    wide = box.grown(0.09)
    outside = (v < wide.y) | (v >= wide.y1) | (u < wide.x) | (u >= wide.x1)
    if not covered.any() or not outside.any():
        return mask
    middle = np.exp(-0.5 * ((v - box.y - box.h / 2) / (MIDDLE * box.h)) ** 2) * np.exp(
        -0.5 * ((u - box.x - box.w / 2) / (MIDDLE * box.w)) ** 2
    )
    kept = _likelier(np.asarray(small, dtype=np.uint8), covered, middle, outside)
    grown = cv2.resize(kept.astype(np.uint8) * 255, (w, h), interpolation=cv2.INTER_LINEAR) >= 128
    cut = cv2.morphologyEx(grown.astype(np.uint8) & inside, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    out = np.zeros_like(mask)
    out[rows, columns] = cut > 0
    return out


def _likelier(color: UInt8, covered: Bool, weight: Float64, outside: Bool) -> Bool:
    """Covered pixels (h, w) that are more likely of the covered pixels' colours, each with its weight, than
    of those outside."""
    lab = cv2.cvtColor(color, cv2.COLOR_RGB2LAB).astype(np.int32) // (256 // BINS)
    place = (lab[..., 0] * BINS + lab[..., 1]) * BINS + lab[..., 2]
    others = np.log(_shares(place, outside.astype(np.float64)) + RARE)
    kept = covered
    for _ in range(ROUNDS):
        ratio = np.log(_shares(place, kept * weight) + RARE) - others
        evidence = np.clip(ratio[place], -MOST_EVIDENCE, MOST_EVIDENCE).astype(np.float32)
        kept = covered & (_smoothed(evidence) > 0)
        if not kept.any():
            break
    return kept


def _smoothed(evidence: Float32) -> Float32:
    return np.asarray(cv2.GaussianBlur(evidence, (0, 0), SMOOTHING_PX), dtype=np.float32)


def _shares(place: np.ndarray, weight: Float64) -> Float64:
    """Share (BINS ** 3,) of each colour in weighted pixels, spread over its neighbours."""
    counts = np.bincount(place.ravel(), weight.ravel(), BINS**3).reshape(BINS, BINS, BINS)
    for axis in range(3):
        turned = np.moveaxis(counts, axis, 0)
        below, above = np.concatenate([turned[:1], turned[:-1]]), np.concatenate([turned[1:], turned[-1:]])
        counts = np.moveaxis(0.5 * turned + 0.25 * (below + above), 0, axis)
    return np.asarray(counts.ravel() / max(float(weight.sum()), 1e-9))
