"""Which pixels of the object are where in the next frame (paper, section III-E, first step).

Candidates are the ridge points of the object's colour pairs, where flow is best determined, and a sparse grid
that keeps even faces from being forgotten. A match is believed when flow confirms it in both directions,
when it ends on the propagated mask, and when the two colours beside it are still the same pair.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.extract import ExtractionConfig, extract
from huepose.colorpair.similarity import paired_similarity
from huepose.colorpair.types import ColorPairs
from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.propose.flow import Flow, sampled
from huepose.propose.mask_propagation import propagate

GRID_STEP_PX = 12
GRID_WEIGHT = 0.3
MAX_PAIRS = 300
MIN_SIMILARITY = 0.35
SIDE_PX = 3.0
"""Distance of the compared colours from a grid point."""


@dataclass(frozen=True, eq=False)
class Correspondences:
    """pixels_a, pixels_b (N, 2): the same surface points in two frames; weights (N,) in 0..1; similarity
    (N,): of their colour pairs."""

    pixels_a: Float64
    pixels_b: Float64
    weights: Float64
    similarity: Float64

    def __len__(self) -> int:
        return len(self.pixels_a)

    def __getitem__(self, chosen: Bool) -> Correspondences:
        """Those that are chosen (N,)."""
        return Correspondences(
            self.pixels_a[chosen], self.pixels_b[chosen], self.weights[chosen], self.similarity[chosen]
        )


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
    """Correspondences of the object that `mask_a` (H, W) outlines in the first of two colour images.

    Only the flow's window is looked at. `pairs`: the first frame's colour pairs on the object where they are
    known already. With use_pairs False colour pairs neither give candidates nor filter (for comparison).
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
        ridge = extract(color_a[window], mask, ExtractionConfig(spacing=3.0, max_pairs=MAX_PAIRS))
    pixels = np.concatenate([ridge.pixels, grid]).astype(np.float32)
    if not len(pixels):
        none = np.zeros((0, 2))
        return Correspondences(none, none, np.zeros(0), np.zeros(0))
    across = np.concatenate(
        [
            np.stack([np.cos(ridge.directions), np.sin(ridge.directions)], 1)
            * (0.5 * ridge.widths + 1.0)[:, None],
            _beside(len(grid)),
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
        similarity = _similarity(lab_a, lab_b, pixels, across, flow)
        good &= similarity >= MIN_SIMILARITY
    return Correspondences(
        (pixels + corner)[good].astype(np.float64),
        (ends + corner)[good].astype(np.float64),
        (weights * similarity)[good],
        similarity[good],
    )


def similarity_beside(color_a: UInt8, color_b: UInt8, pixels: Float64, flow: Flow) -> Float64:
    """How alike the two colours beside points of the first image (N, 2) are to those where flow takes them,
    (N,) in 0..1: what `match` asks of its grid."""
    h, w = flow.consistent.shape
    window = np.s_[flow.y0 : flow.y0 + h, flow.x0 : flow.x0 + w]
    local = (pixels - np.array([flow.x0, flow.y0])).astype(np.float32)
    lab_a, lab_b = lab_of(color_a[window]), lab_of(color_b[window])
    return _similarity(lab_a, lab_b, local, _beside(len(local)).astype(np.float32), flow)


def _beside(count: int) -> Float64:
    """From each of so many grid points to one of its compared colours, (N, 2)."""
    return np.tile(np.array([[SIDE_PX, 0.0]]), (count, 1))


def _similarity(lab_a: Float32, lab_b: Float32, pixels: Float32, across: Float32, flow: Flow) -> Float64:
    """Of the colours at both sides of pixels (N, 2) of the window, `across` (N, 2) away from them, to those
    in the second image. The sides move with the surface, not with the point: each follows its own flow."""
    sides = (pixels - across, pixels + across)
    before = np.stack([sampled(lab_a, q) for q in sides], 1)
    after = np.stack([sampled(lab_b, q + sampled(flow.forward, q)) for q in sides], 1)
    return paired_similarity(before, after).astype(np.float64)


def _grid(mask: Bool, step_px: int) -> Float32:
    """Every `step_px`-th pixel of the mask, (N, 2) as (u, v)."""
    half = step_px // 2
    rows, columns = np.nonzero(mask[half::step_px, half::step_px])
    return (np.stack([columns, rows], 1) * step_px + half).astype(np.float32)
