"""2D correspondences of an object between two frames, by optical flow (paper, section III-E, first step).

Candidates are the ridge points of the object's colour pairs, where flow is best determined, and a sparse grid
that also covers faces without edges. A correspondence is kept if the flow is consistent forward and backward,
if it ends on the mask that flow moved to the second frame, and if the colours on both sides stay similar.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.extract import extract
from huepose.colorpair.similarity import paired_similarity
from huepose.colorpair.types import ColorPairs
from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.propose.flow import Flow, sampled

GRID_STEP_PX, GRID_WEIGHT = 12, 0.3
"""Spacing of the grid points, and the weight of each; a colour pair has weight 1."""
MAX_PAIRS = 300
"""Largest number of colour pairs of a frame that are followed."""
MIN_SIMILARITY = 0.35
"""Least colour-pair similarity (0..1) of a kept correspondence."""
SIDE_PX = 3.0
"""Distance from a grid point to the two compared colours."""


@dataclass(frozen=True, eq=False)
class Correspondences:
    """pixels_a, pixels_b (N, 2): the same surface points in two frames; weights (N,) in 0..1."""

    pixels_a: Float64
    pixels_b: Float64
    weights: Float64

    def __len__(self) -> int:
        return len(self.pixels_a)

    def __getitem__(self, chosen: Bool) -> Correspondences:
        """The correspondences selected by a mask (N,)."""
        return Correspondences(self.pixels_a[chosen], self.pixels_b[chosen], self.weights[chosen])


def lab_of(color: UInt8) -> Float32:
    """CIELAB (H, W, 3) float32, L 0..100, of sRGB bytes."""
    return np.asarray(cv2.cvtColor(color.astype(np.float32) / 255.0, cv2.COLOR_RGB2Lab))


def match(
    color_a: UInt8,
    color_b: UInt8,
    mask_a: Bool,
    flow: Flow,
    use_pairs: bool = True,
    pairs: ColorPairs | None = None,
    grid_step_px: int = GRID_STEP_PX,
) -> Correspondences:
    """Correspondences of the object that `mask_a` (H, W) covers in the first of two colour images.

    Only the flow's window is used. `pairs`: the first frame's colour pairs on the object, if they are already
    known. With use_pairs False colour pairs neither give candidates nor filter (for comparison).
    """
    h, w = flow.consistent.shape
    window = np.s_[flow.y0 : flow.y0 + h, flow.x0 : flow.x0 + w]
    corner = np.array([flow.x0, flow.y0], np.float32)
    mask = np.ascontiguousarray(mask_a[window])
    lab_a, lab_b = lab_of(color_a[window]), lab_of(color_b[window])
    grid = _grid(mask, grid_step_px)
    if not use_pairs:
        ridge = ColorPairs.empty()
    elif pairs is not None:
        ridge = ColorPairs(pairs.pixels - corner, pairs.directions, pairs.widths, pairs.colors)
    else:
        ridge = pairs_to_follow(color_a[window], mask)
    pixels = np.concatenate([ridge.pixels, grid]).astype(np.float32)
    if not len(pixels):
        none = np.zeros((0, 2))
        return Correspondences(none, none, np.zeros(0))
    offsets = np.concatenate(
        [
            np.stack([np.cos(ridge.directions), np.sin(ridge.directions)], 1)
            * (0.5 * ridge.widths + 1.0)[:, None],
            _side_offsets(len(grid)),
        ]
    ).astype(np.float32)
    weights = np.concatenate([np.ones(len(ridge)), np.full(len(grid), GRID_WEIGHT)])
    moved, good = flow.at(pixels + corner)
    ends = pixels + moved.astype(np.float32)
    mask_b = propagate(mask_a, flow)[window]
    columns, rows = np.clip(np.rint(ends), 0, [w - 1, h - 1]).astype(int).T
    good &= mask_b[rows, columns]
    similarity = np.ones(len(pixels))
    if use_pairs:
        similarity = _side_similarity(lab_a, lab_b, pixels, offsets, flow)
        good &= similarity >= MIN_SIMILARITY
    return Correspondences(
        (pixels + corner)[good].astype(np.float64),
        (ends + corner)[good].astype(np.float64),
        (weights * similarity)[good],
    )


def pairs_to_follow(color: UInt8, mask: Bool) -> ColorPairs:
    """The colour pairs in an object's mask (H, W) that are followed from an image (H, W, 3)."""
    return extract(color, mask, spacing=3.0, max_pairs=MAX_PAIRS)


def side_color_similarity(color_a: UInt8, color_b: UInt8, pixels: Float64, flow: Flow) -> Float64:
    """Similarity (N,) in 0..1 of the colours on both sides of pixels (N, 2) of the first image and of the
    ends of their flow in the second: the test that `match` applies to its grid."""
    h, w = flow.consistent.shape
    window = np.s_[flow.y0 : flow.y0 + h, flow.x0 : flow.x0 + w]
    local = (pixels - np.array([flow.x0, flow.y0])).astype(np.float32)
    lab_a, lab_b = lab_of(color_a[window]), lab_of(color_b[window])
    return _side_similarity(lab_a, lab_b, local, _side_offsets(len(local)).astype(np.float32), flow)


def _side_offsets(count: int) -> Float64:
    """Offsets (N, 2) in pixels from grid points to one of their two compared colours."""
    return np.tile(np.array([[SIDE_PX, 0.0]]), (count, 1))


def _side_similarity(
    lab_a: Float32, lab_b: Float32, pixels: Float32, offsets: Float32, flow: Flow
) -> Float64:
    """Similarity (N,) of the colours at pixels (N, 2) minus and plus `offsets` (N, 2) in both images, in
    window coordinates. Each side is moved by its own flow, since the two may lie on different surfaces."""
    sides = (pixels - offsets, pixels + offsets)
    before = np.stack([sampled(lab_a, q) for q in sides], 1)
    after = np.stack([sampled(lab_b, q + sampled(flow.forward, q)) for q in sides], 1)
    return paired_similarity(before, after).astype(np.float64)


def _grid(mask: Bool, step_px: int) -> Float32:
    """Grid points (u, v) (N, 2) on the mask, `step_px` apart."""
    half = step_px // 2
    rows, columns = np.nonzero(mask[half::step_px, half::step_px])
    return (np.stack([columns, rows], 1) * step_px + half).astype(np.float32)


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
