"""Colour pairs of an image, from pixels to two colours per edge point (paper, section III-B, all of it).

First, chroma noise is removed and edges are kept: two passes of a small bilateral filter on the colours, then
a joint bilateral filter on a and b that is guided by L. Real sensors are noisier in colour than in lightness,
so lightness shows where the edges are.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from huepose.colorpair.ridges import Ridges, find_ridges, unified_gradient
from huepose.colorpair.sampling import sample_sides
from huepose.colorpair.types import ColorPairs
from huepose.geometry.arrays import Bool, Float32, Int, UInt8
from huepose.geometry.box import Box
from huepose.support.jit import jit

DENOISE_PX = 5
"""Side of the filters, pixels."""

SIGMA_SPACE_PX, SIGMA_COLOR, SIGMA_GUIDE = 1.5, (20.0, 14.0), 6.0
"""Sigmas of the filters' weights: of distance; of colour in each pass of the bilateral filter, 8-bit steps;
of the guide, units of L."""

MARGIN = 8
"""Margin around a mask that filters may read, pixels."""

MASK_SHARE = 200
"""Of 255: a pixel of a reduced image belongs to the mask if more than this share of its area does."""

LEAST_SIDE_PX = 8
"""In a smaller image no pairs are searched."""


def to_lab(color: UInt8) -> Float32:
    """CIELAB (H, W, 3) float32, L 0..100, of an sRGB image (H, W, 3) uint8."""
    return np.asarray(cv2.cvtColor(color.astype(np.float32) * np.float32(1 / 255), cv2.COLOR_RGB2Lab))


def denoise(color: UInt8) -> Float32:
    """CIELAB (H, W, 3) float32 of an sRGB image (H, W, 3) uint8 RGB, noise removed and edges kept.

    A constant image comes back unchanged up to rounding.
    """
    smooth = np.ascontiguousarray(color)
    for sigma in SIGMA_COLOR:
        smooth = np.asarray(cv2.bilateralFilter(smooth, DENOISE_PX, sigma, SIGMA_SPACE_PX), np.uint8)
    return joint_bilateral(to_lab(smooth))


def joint_bilateral(lab: Float32) -> Float32:
    """Filter a and b of a CIELAB image (H, W, 3) with weights of distance and of the difference in L.

    L is returned as it is. The window is round; borders cut it.
    """
    radius = DENOISE_PX // 2
    span = np.arange(-radius, radius + 1)
    dv, du = (a.ravel() for a in np.meshgrid(span, span, indexing="ij"))
    inside = du**2 + dv**2 <= (radius + 0.3) ** 2
    du, dv = du[inside], dv[inside]
    space = np.exp(-(du**2 + dv**2) / (2.0 * SIGMA_SPACE_PX**2)).astype(np.float32)
    steps = np.arange(256, dtype=np.float32) * (3.0 * SIGMA_GUIDE / 255.0)
    table = np.exp(-(steps**2) / (2.0 * SIGMA_GUIDE**2)).astype(np.float32)
    table[-1] = 0.0
    scale = 255.0 / (3.0 * SIGMA_GUIDE)
    return _joint_bilateral(np.ascontiguousarray(lab, np.float32), du, dv, space, table, scale)


@jit
def _joint_bilateral(lab: Float32, du: Int, dv: Int, space: Float32, table: Float32, scale: float) -> Float32:
    height, width = lab.shape[0], lab.shape[1]
    out = np.empty_like(lab)
    for v in range(height):
        for u in range(width):
            lightness = lab[v, u, 0]
            total = np.float32(0.0)
            a = np.float32(0.0)
            b = np.float32(0.0)
            for k in range(du.shape[0]):
                y, x = v + dv[k], u + du[k]
                if y < 0 or x < 0 or y >= height or x >= width:
                    continue
                i = int(abs(lab[y, x, 0] - lightness) * scale)
                if i > 254:
                    continue
                w = space[k] * table[i]
                total += w
                a += w * lab[y, x, 1]
                b += w * lab[y, x, 2]
            out[v, u, 0] = lightness
            out[v, u, 1] = a / total
            out[v, u, 2] = b / total
    return out


def extract(
    color: UInt8,
    mask: Bool | None = None,
    *,
    spacing: float = 2.0,
    max_pairs: int = 1500,
    scale: float = 1.0,
) -> ColorPairs:
    """Colour pairs of an sRGB image (H, W, 3) uint8 RGB, strongest edges first.

    With a mask (H, W) only its surroundings are read, and both sides of every pair lie inside it. spacing:
    smallest distance of two ridge points in pixels, made larger until at most `max_pairs` remain. With a
    `scale` under 1 the image is first reduced by that factor, so that an object has edges of the same kind
    near and far; positions and widths are still in pixels of `color`.
    """
    box = Box(0, 0, color.shape[1], color.shape[0]) if mask is None else Box.of_mask(mask)
    if box is None:
        return ColorPairs.empty()
    rows, columns = box.grown(0.0, MARGIN).slices(color.shape[1], color.shape[0])
    part = color[rows, columns]
    whole = part.shape[1::-1]
    if scale < 1.0 and part.size:
        size = tuple(max(round(side * scale), LEAST_SIDE_PX) for side in whole)
        part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.uint8)
    height, width = part.shape[:2]
    if height < LEAST_SIDE_PX or width < LEAST_SIDE_PX:
        return ColorPairs.empty()
    inside = np.ones((height, width), np.bool_)
    if mask is not None:
        area = mask[rows, columns].astype(np.uint8) * np.uint8(255)
        inside = np.asarray(cv2.resize(area, (width, height), interpolation=cv2.INTER_AREA) > MASK_SHARE)
    pairs = _extract(denoise(part), inside, spacing, max_pairs)
    steps = np.array(whole) / part.shape[1::-1]
    pixels = (pairs.pixels + 0.5) * steps - 0.5 + np.array([columns.start, rows.start])
    return replace(
        pairs, pixels=pixels.astype(np.float32), widths=(pairs.widths * steps.mean()).astype(np.float32)
    )


def _extract(lab: Float32, mask: Bool, spacing: float, max_pairs: int) -> ColorPairs:
    """Colour pairs of a denoised CIELAB image (H, W, 3), in its own pixels."""
    ridges = find_ridges(unified_gradient(lab), mask)
    ridges = _take(ridges, np.argsort(-ridges.strengths, kind="stable"))
    colors, valid = sample_sides(lab, ridges, mask, spacing, max_pairs)
    ridges, colors = _take(ridges, valid), colors[valid]
    angles = np.arctan2(ridges.directions[:, 1], ridges.directions[:, 0])
    return ColorPairs(ridges.pixels, angles.astype(np.float32), ridges.widths, colors)


def _take(ridges: Ridges, index: np.ndarray) -> Ridges:
    return Ridges(
        ridges.cells[index],
        ridges.pixels[index],
        ridges.directions[index],
        ridges.strengths[index],
        ridges.widths[index],
    )
