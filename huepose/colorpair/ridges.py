"""Edges of a colour image: its unified gradient, and the centrelines of edges with sub-pixel position and
thickness (paper, section III-B, edge localisation).

The gradient has the energy of all channels and the direction of the strongest. Non-maximum suppression along
it leaves lines one pixel wide. Thickness is measured by association: every pixel of a gradient region points
to its strongest neighbour; the pointers are followed until they end on a ridge; the number of pixels that end
on a ridge point is the local thickness. Only pixels with a fixed share of their ridge's strength count, so
that thickness means sharpness, not contrast: a step blurred by a Gaussian of `s` pixels is about 3 s wide.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, Int32
from huepose.support.jit import jit, jit_dividing

THRESHOLD, NOISE_FACTOR, MAX_THRESHOLD = 2.0, 3.0, 8.0
"""Smallest magnitude of a ridge, CIELAB units per pixel: THRESHOLD on a clean image; on a noisy one
NOISE_FACTOR times the magnitude that a fifth of the pixels do not exceed, at most MAX_THRESHOLD."""

MIN_LENGTH = 5
"""Fewest connected ridge pixels: noise makes short lines."""

MEMBER_SHARE = 0.3
"""Share of the ridge's magnitude that a pixel needs to count for its thickness."""

SMOOTHING_PX = 2
"""Radius within which the thickness of neighbouring ridge points is averaged."""


@dataclass(frozen=True, eq=False)
class Gradient:
    """magnitude (H, W) float32: change of CIELAB per pixel, all channels together; direction (H, W, 2)
    float32: unit vector (du, dv) along the gradient of the channel that changes most, 0 where nothing
    changes."""

    magnitude: Float32
    direction: Float32


def unified_gradient(lab: Float32) -> Gradient:
    """Gradient of a CIELAB image (H, W, 3) float32, by Scharr's derivative.

    On a linear ramp of s units per pixel in each of k channels the magnitude is s sqrt(k). A colour ramp
    whose channels run in opposite directions keeps its energy: only the direction is taken from one channel.
    """
    du = np.asarray(cv2.Scharr(lab, cv2.CV_32F, 1, 0, scale=1 / 32), np.float32)
    dv = np.asarray(cv2.Scharr(lab, cv2.CV_32F, 0, 1, scale=1 / 32), np.float32)
    return Gradient(*_combine(du, dv))


@jit
def _combine(du: Float32, dv: Float32) -> tuple[Float32, Float32]:
    height, width = du.shape[0], du.shape[1]
    magnitude = np.zeros((height, width), np.float32)
    direction = np.zeros((height, width, 2), np.float32)
    for v in range(height):
        for u in range(width):
            energy = np.float32(0.0)
            strongest = np.float32(0.0)
            channel = 0
            for c in range(3):
                e = du[v, u, c] * du[v, u, c] + dv[v, u, c] * dv[v, u, c]
                energy += e
                if e > strongest:
                    strongest = e
                    channel = c
            if strongest > 1e-12:
                length = np.sqrt(strongest)
                magnitude[v, u] = np.sqrt(energy)
                direction[v, u, 0] = du[v, u, channel] / length
                direction[v, u, 1] = dv[v, u, channel] / length
    return magnitude, direction


@dataclass(frozen=True, eq=False)
class Ridges:
    """cells (N, 2) int32: row and column; pixels (N, 2) float32: sub-pixel position (u, v); directions (N, 2)
    float32: unit vector across the edge; strengths (N,): magnitude; widths (N,): thickness in pixels."""

    cells: Int32
    pixels: Float32
    directions: Float32
    strengths: Float32
    widths: Float32

    def __len__(self) -> int:
        return len(self.pixels)


def find_ridges(gradient: Gradient, mask: Bool | None = None) -> Ridges:
    """Ridge points of a gradient field, inside `mask` (H, W) where it is given; the outermost pixels have
    none."""
    allowed = np.ones(gradient.magnitude.shape, np.bool_) if mask is None else np.ascontiguousarray(mask)
    threshold = _noise_threshold(gradient.magnitude[allowed])
    # the sub-pixel offset along the direction at ridge points, nan elsewhere
    offsets = _suppress(gradient.magnitude, gradient.direction, allowed, threshold)
    is_ridge = long_enough(~np.isnan(offsets))
    counts = _associate(gradient.magnitude, is_ridge, threshold)
    flat = np.flatnonzero(is_ridge)
    v, u = np.divmod(flat, is_ridge.shape[1])
    cells = np.stack([v, u], 1).astype(np.int32)
    directions = gradient.direction.reshape(-1, 2)[flat]
    pixels = np.stack([u, v], 1).astype(np.float32) + offsets.ravel()[flat][:, None] * directions
    # a diagonal line has fewer ridge pixels per length: each counts for more of the region
    across = np.abs(directions)
    widths = _local_mean(counts, cells) * np.maximum(across[:, 0], across[:, 1])
    return Ridges(cells, pixels, directions, gradient.magnitude.ravel()[flat], widths)


def _noise_threshold(magnitudes: Float32) -> float:
    """The magnitude over which a ridge counts, from the magnitudes (N,) of the region: most pixels of a
    region are not edges, so the lowest fifth of them shows the noise."""
    if not len(magnitudes):
        return THRESHOLD
    k = len(magnitudes) // 5
    level = float(np.partition(magnitudes, k)[k])
    return float(np.clip(NOISE_FACTOR * level, THRESHOLD, MAX_THRESHOLD))


def long_enough(is_ridge: Bool) -> Bool:
    """The ridge pixels (H, W) in 8-connected lines of at least MIN_LENGTH."""
    count, labels = cv2.connectedComponents(is_ridge.view(np.uint8), connectivity=8)
    lengths = np.bincount(labels[is_ridge], minlength=count)
    return np.asarray((lengths >= MIN_LENGTH)[labels])


@jit
def _suppress(magnitude: Float32, direction: Float32, allowed: Bool, threshold: float) -> Float32:
    height, width = magnitude.shape
    out = np.full((height, width), np.nan, np.float32)
    for v in range(2, height - 2):
        for u in range(2, width - 2):
            m = magnitude[v, u]
            if m < threshold or not allowed[v, u]:
                continue
            du, dv = direction[v, u, 0], direction[v, u, 1]
            # Largest of its row (or column, for a flat line): on a slanted line just one pixel of a row is.
            # Of two equal ones (a step exactly between two pixels) the first in reading order is taken.
            if abs(du) >= abs(dv):
                if magnitude[v, u - 1] >= m or magnitude[v, u + 1] > m:
                    continue
                step = 1 if du > 0 else -1
                f = abs(dv / du)
                lean = step if dv * du > 0 else -step
                ahead = (1 - f) * magnitude[v, u + step] + f * magnitude[v + lean, u + step]
                behind = (1 - f) * magnitude[v, u - step] + f * magnitude[v - lean, u - step]
            else:
                if magnitude[v - 1, u] >= m or magnitude[v + 1, u] > m:
                    continue
                step = 1 if dv > 0 else -1
                f = abs(du / dv)
                lean = step if dv * du > 0 else -step
                ahead = (1 - f) * magnitude[v + step, u] + f * magnitude[v + step, u + lean]
                behind = (1 - f) * magnitude[v - step, u] + f * magnitude[v - step, u - lean]
            curvature = ahead - 2 * m + behind
            offset = 0.0
            if curvature < 0:
                offset = 0.5 * (behind - ahead) / curvature * np.sqrt(1 + f * f)
            out[v, u] = min(max(offset, -0.75), 0.75)
    return out


@jit_dividing
def _strongest(magnitude: Float32, is_ridge: Bool) -> Int32:
    """(H, W) int32: offset, in reading order, from each pixel to the neighbour that it points to; 0 where it
    points to none and at the outermost pixels.

    A pixel points to an adjacent ridge pixel that is at least as strong as itself and all other neighbours;
    else to its strongest neighbour, if that is stronger than the pixel itself.
    """
    height, width = magnitude.shape
    none = np.float32(-1.0)
    # ridge pixels and the others in planes of their own: the loops have no branches and can be vectorised
    planes = np.empty((2, height, width), np.float32)
    for v in range(height):
        for u in range(width):
            planes[0, v, u] = magnitude[v, u] if is_ridge[v, u] else none
            planes[1, v, u] = none if is_ridge[v, u] else magnitude[v, u]
    step = np.zeros((height, width), np.int32)
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            best, at = none, np.int32(0)
            for p in range(2):
                for k in (4, 0, 1, 2, 3, 5, 6, 7, 8):  # of equal ones the first counts: the pixel itself
                    dv, du = k // 3 - 1, k % 3 - 1
                    there = planes[p, v + dv, u + du]
                    at = np.int32(dv * width + du) if there > best else at
                    best = max(best, there)
            step[v, u] = at
    return step


@jit
def _associate(magnitude: Float32, is_ridge: Bool, threshold: float) -> Int32:
    """(H, W) int32: how many pixels end on each ridge point, itself included; 0 elsewhere."""
    step = _strongest(magnitude, is_ridge).ravel()
    strength, ridge = magnitude.ravel(), is_ridge.ravel()
    floor = threshold * MEMBER_SHARE
    counts = np.zeros(is_ridge.shape, np.int32)
    ends = counts.ravel()
    for i in range(len(step)):
        if strength[i] < floor:
            continue
        j = i
        while not ridge[j] and step[j] != 0:
            j += step[j]
        if ridge[j] and strength[i] >= MEMBER_SHARE * strength[j]:
            ends[j] += 1
    return counts


@jit
def _local_mean(counts: Int32, cells: Int32) -> Float32:
    """Thickness at each cell: the mean count of the ridge points around it (counts are whole numbers)."""
    height, width = counts.shape
    out = np.empty(cells.shape[0], np.float32)
    for k in range(cells.shape[0]):
        total = 0
        n = 0
        for y in range(max(cells[k, 0] - SMOOTHING_PX, 0), min(cells[k, 0] + SMOOTHING_PX + 1, height)):
            for x in range(max(cells[k, 1] - SMOOTHING_PX, 0), min(cells[k, 1] + SMOOTHING_PX + 1, width)):
                if counts[y, x] > 0:
                    total += counts[y, x]
                    n += 1
        out[k] = total / n if n else 1.0
    return out
