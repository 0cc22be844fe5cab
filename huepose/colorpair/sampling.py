"""The two colours of an edge, sampled as far out as the edge is thick (paper, section III-B, colour-pair
sampling).

On each side a profile of candidates is read at distances proportional to the thickness. Their common
covariance whitens the local colour distribution; in the whitened space the axis between the two sides'
medians is the transition, and candidates that lie too far along it from their own side, or too far off it,
are rejected: they lie on the slope, on the next edge or on a speck. The median of the rest is the colour.
"""

from __future__ import annotations

import numpy as np

from huepose.colorpair.ridges import Ridges
from huepose.geometry.arrays import Bool, Float32, Float64, Int32
from huepose.support.jit import jit_dividing

DISTANCES = (0.6, 0.8, 1.0, 1.2, 1.4)
"""Distances of the candidates from the edge, in units of its thickness."""

MIN_WIDTH_PX, MAX_WIDTH_PX = 2.0, 7.0
"""Bounds of the thickness that is used."""

GATE_ALONG, GATE_ACROSS = 0.35, 2.0
"""A candidate may be off its side's median by GATE_ALONG times the distance between the two sides, and off
the axis by GATE_ACROSS whitened units."""

FLOOR = 1.5
"""Standard deviation added to the covariance, CIELAB units."""

MIN_CANDIDATES = 3
"""Fewest candidates of a side that must lie inside the mask."""

MIN_CONTRAST = 6.0
"""Smallest CIELAB distance of the two colours of a pair."""


def sample_sides(
    lab: Float32,
    ridges: Ridges,
    mask: Bool | None = None,
    spacing: float = 0.0,
    limit: int | None = None,
) -> tuple[Float32, Bool]:
    """Colours (N, 2, 3) float32 of the sides against and along each ridge's direction, and which are valid
    (N,): those with MIN_CONTRAST or more, none nearer than `spacing` pixels to an earlier valid one.

    `lab` (H, W, 3) float32 CIELAB; candidates outside the image or `mask` (H, W) are not used. When more than
    `limit` are valid, the spacing is made larger by a quarter until they are not.
    """
    allowed = np.ones(lab.shape[:2], np.bool_) if mask is None else np.ascontiguousarray(mask)
    widths = np.clip(ridges.widths, MIN_WIDTH_PX, MAX_WIDTH_PX).astype(np.float32)
    picture, distances = np.ascontiguousarray(lab, np.float32), np.asarray(DISTANCES, np.float32)
    while True:
        colors, valid = _sample(
            picture, allowed, ridges.pixels, ridges.directions, widths, distances, spacing
        )
        if limit is None or int(valid.sum()) <= limit:
            return colors, valid
        spacing *= 1.25


@jit_dividing
def _median(values: Float64, n: int) -> float:
    """Median of the first n values, sorted in place."""
    for i in range(1, n):
        x = values[i]
        # without a branch, which could not be predicted
        for j in range(i, 0, -1):
            values[j], x = max(x, values[j - 1]), min(x, values[j - 1])
        values[0] = x
    return float(0.5 * (values[(n - 1) // 2] + values[n // 2]))


@jit_dividing
def _factor(cov: Float64, factor: Float64) -> None:
    """The Cholesky factor L of a covariance (3, 3), as (6,): the inverses of its diagonal, then L10, L20,
    L21."""
    factor[0] = 1.0 / np.sqrt(cov[0, 0])
    factor[3] = cov[1, 0] * factor[0]
    factor[4] = cov[2, 0] * factor[0]
    factor[1] = 1.0 / np.sqrt(cov[1, 1] - factor[3] * factor[3])
    factor[5] = (cov[2, 1] - factor[4] * factor[3]) * factor[1]
    factor[2] = 1.0 / np.sqrt(cov[2, 2] - factor[4] * factor[4] - factor[5] * factor[5])


@jit_dividing
def _whiten(factor: Float64, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Solve L w = (x, y, z) for a factor of `_factor`: the whitened vector."""
    w0 = x * factor[0]
    w1 = (y - factor[3] * w0) * factor[1]
    w2 = (z - factor[4] * w0 - factor[5] * w1) * factor[2]
    return w0, w1, w2


@jit_dividing
def _is_free(i: int, pixels: Float32, spacing: float, cell: float, head: Int32, follow: Int32) -> bool:
    """Whether point i of (N, 2) is no nearer than `spacing` to any point that was put into the cells.

    head (rows, columns): the last point of each cell; follow (N,): the one before each point; -1 for none.
    """
    r, c = int(pixels[i, 1] / cell), int(pixels[i, 0] / cell)
    for y in range(max(r - 1, 0), min(r + 2, head.shape[0])):
        for x in range(max(c - 1, 0), min(c + 2, head.shape[1])):
            j = head[y, x]
            while j >= 0:
                du, dv = pixels[i, 0] - pixels[j, 0], pixels[i, 1] - pixels[j, 1]
                if du * du + dv * dv < spacing * spacing:
                    return False
                j = follow[j]
    return True


@jit_dividing
def _sample(
    lab: Float32,
    allowed: Bool,
    pixels: Float32,
    directions: Float32,
    widths: Float32,
    distances: Float32,
    spacing: float,
) -> tuple[Float32, Bool]:
    """See `sample_sides`; an edge too near to a valid one is skipped."""
    height, width = allowed.shape
    count, reach = pixels.shape[0], distances.shape[0]
    colors = np.zeros((count, 2, 3), np.float32)
    valid = np.zeros(count, np.bool_)
    c = np.empty((2, reach, 3))
    n = np.zeros(2, np.int64)
    scratch = np.empty(2 * reach)
    medians = np.empty((2, 3))
    mean = np.empty(3)
    cov, factor = np.empty((3, 3)), np.empty(6)
    along = np.empty((2, reach))
    across = np.empty((2, reach))
    cell = max(spacing, 1.0)
    head = np.full((int(height / cell) + 2, int(width / cell) + 2), -1, np.int32)
    follow = np.full(count, -1, np.int32)
    for i in range(count):
        if not _is_free(i, pixels, spacing, cell, head, follow):
            continue
        usable = True
        for side in range(2):
            sign = -1.0 if side == 0 else 1.0
            n[side] = 0
            for k in range(reach):
                x = pixels[i, 0] + sign * distances[k] * widths[i] * directions[i, 0]
                y = pixels[i, 1] + sign * distances[k] * widths[i] * directions[i, 1]
                u, v = int(np.floor(x)), int(np.floor(y))
                if u < 0 or v < 0 or u > width - 2 or v > height - 2:
                    break
                if not allowed[int(y + 0.5), int(x + 0.5)]:
                    break  # beyond the outline: what lies farther out is another surface too
                fu, fv = x - u, y - v
                for q in range(3):
                    top = lab[v, u, q] * (1 - fu) + lab[v, u + 1, q] * fu
                    low = lab[v + 1, u, q] * (1 - fu) + lab[v + 1, u + 1, q] * fu
                    c[side, n[side], q] = top * (1 - fv) + low * fv
                n[side] += 1
            if n[side] < MIN_CANDIDATES:
                usable = False
                break
        if not usable:
            continue
        total = n[0] + n[1]
        for q in range(3):
            mean[q] = 0.0
            for side in range(2):
                for k in range(n[side]):
                    scratch[k] = c[side, k, q]
                    mean[q] += c[side, k, q] / total
                medians[side, q] = _median(scratch, n[side])
        for p in range(3):
            for q in range(p + 1):
                s = 0.0
                for side in range(2):
                    for k in range(n[side]):
                        s += (c[side, k, p] - mean[p]) * (c[side, k, q] - mean[q])
                cov[p, q] = s / total + (FLOOR * FLOOR if p == q else 0.0)
        _factor(cov, factor)
        a0, a1, a2 = _whiten(
            factor,
            medians[1, 0] - medians[0, 0],
            medians[1, 1] - medians[0, 1],
            medians[1, 2] - medians[0, 2],
        )
        separation = np.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
        if separation < 1e-6:
            continue
        for side in range(2):
            for k in range(n[side]):
                # relative to the side's own median: 0 along the axis means equal to it
                w0, w1, w2 = _whiten(
                    factor,
                    c[side, k, 0] - medians[side, 0],
                    c[side, k, 1] - medians[side, 1],
                    c[side, k, 2] - medians[side, 2],
                )
                t = (w0 * a0 + w1 * a1 + w2 * a2) / separation
                along[side, k] = abs(t) / separation
                across[side, k] = np.sqrt(max(w0 * w0 + w1 * w1 + w2 * w2 - t * t, 0.0))
            for q in range(3):
                kept = 0
                for k in range(n[side]):
                    if along[side, k] <= GATE_ALONG and across[side, k] <= GATE_ACROSS:
                        scratch[kept] = c[side, k, q]
                        kept += 1
                colors[i, side, q] = _median(scratch, kept) if kept else medians[side, q]
        contrast = np.float32(0.0)
        for q in range(3):
            contrast += (colors[i, 1, q] - colors[i, 0, q]) ** 2
        if np.sqrt(contrast) >= MIN_CONTRAST:
            valid[i] = True
            row, column = int(pixels[i, 1] / cell), int(pixels[i, 0] / cell)
            follow[i], head[row, column] = head[row, column], i
    return colors, valid
