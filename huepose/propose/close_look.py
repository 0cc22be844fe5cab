"""The close look: the second, detailed comparison of view templates with the image, cell by cell.

The depth of a template is the one at which most of its cells agree with the image (the mode of the
differences). At this depth cells fit, are occluded (the measured depth is nearer) or violate free space (it
is farther); colours are correlated over the cells that fit. So depth alone separates an object from one
that half occludes it.

The loops run over all cells of a template, with weights instead of branches, so that the compiler
vectorises them.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from huepose.colorpair.opponents import LINEAR
from huepose.geometry.arrays import Float32, Float64, Int32, Int64, UInt8, UInt16
from huepose.judge.kernel import MARGIN
from huepose.judge.weights import DEFAULT_WEIGHTS
from huepose.propose.quick_look import MIN_SHARE, write_opponents
from huepose.propose.templates import (
    BESIDE,
    MILLIMETRES,
    NOT_COVERED,
    RELIEF_STEPS,
    STEPS,
    TemplateTable,
)
from huepose.support.jit import jit_dividing

FIT_WEIGHT, VIOLATION_WEIGHT = DEFAULT_WEIGHTS.depth_fit, DEFAULT_WEIGHTS.violation
COLOR_WEIGHT, BOX_WEIGHT, OCCLUDED_WEIGHT = 0.7, 1.4, 0.1
"""Weights of the terms; depth fit and free-space violation as in `judge.terms`, the others chosen."""

CHANNEL_WEIGHTS = np.array([0.4, 1.0, 1.0])
"""Weights in the correlation, of lightness (which shading changes), red-green and yellow-blue."""

CHANNEL_FLOOR, PLAIN = 3.0, 4.0
"""Opponent units, added to the product of a channel's standard deviations and to the sum of the channels'
weights. They keep the correlation of plain cells low. Chosen."""

TOLERANCE, MIN_TOLERANCE_MM = 0.05, 8.0
"""A cell fits if its depth differs by less than this share of the diameter, or these millimetres if that is
more."""

MAX_OFFSET = 0.75
"""Largest offset between the template's depth and the median depth of the window, in diameters."""

BINS = 64
"""Bins of the histogram of depth offsets."""

FEWEST, NO_SCORE = 4, -9.0
"""Least number of known cells for a score, and of fitting cells for a correlation; the score if fewer are
known, which is lower than all others."""

UNKNOWN_MM, KNOWN_MM = np.float32(1e9), np.float32(5e8)
"""Relief of a cell without depth; relief below KNOWN_MM is known."""


class Canvas(NamedTuple):
    """The image resampled to template cells. color (n, n, 3): opponents; relief (n, n): millimetres from
    the median depth, UNKNOWN_MM where there is none; bounds (4,): left, top, right, bottom of the box in
    cells."""

    color: Float32
    relief: Float32
    bounds: Float64


class _Scratch(NamedTuple):
    """Work arrays for the cells of one template. where (C,): their indices in the flat canvas; differences
    (C,): measured minus template relief there, millimetres; bins (C,): of the histogram (2 * (BINS + 2),);
    near (C,): 1 where the cell fits, else 0; colors (3 * C,): of the image, channel by channel."""

    where: Int64
    differences: Float32
    bins: Int32
    histogram: Int32
    near: Float32
    colors: Float32


def canvas_of(color: UInt8, depth: Float32, fine: int, middle_m: float, bounds: Float64) -> Canvas:
    """The canvas of samples (n, n) as made by `quick_look.sampled`. Relief is the one reading in the middle
    of a cell: a mean across a depth step would lie on no surface."""
    cells = len(depth) // fine
    colors = np.zeros((cells, cells, 3), np.float32)
    relief = np.full((cells, cells), UNKNOWN_MM, np.float32)
    smooth = np.asarray(cv2.medianBlur(depth, 3), dtype=np.float32)
    _fill(color, depth, smooth, fine, middle_m, colors, relief)
    return Canvas(colors, relief, bounds)


@jit_dividing
def _fill(
    color: UInt8,
    depth: Float32,
    smooth: Float32,
    fine: int,
    middle_m: float,
    colors: Float32,
    relief: Float32,
) -> None:
    for y in range(relief.shape[0]):
        for x in range(relief.shape[1]):
            red, green, blue, known = 0.0, 0.0, 0.0, 0.0
            for v in range(y * fine, (y + 1) * fine):
                for u in range(x * fine, (x + 1) * fine):
                    if depth[v, u] > 0.0:
                        red += LINEAR[color[v, u, 0]]
                        green += LINEAR[color[v, u, 1]]
                        blue += LINEAR[color[v, u, 2]]
                        known += 1.0
            z = smooth[y * fine + fine // 2, x * fine + fine // 2]
            if z > 0.0 and known > MIN_SHARE * fine * fine:
                relief[y, x] = (z - middle_m) * MILLIMETRES
                write_opponents(red / known, green / known, blue / known, colors[y, x])


def check_templates(
    table: TemplateTable, canvas: Canvas, templates: Int64, corners: Int64
) -> tuple[Float64, Float64]:
    """Score templates (K,) whose top-left cells are at `corners` (K, 2) (x, y) of the canvas.

    Returns scores (K,), and the depth offset (K,) in millimetres at which each fits best."""
    scores, offsets = np.zeros(len(templates)), np.zeros(len(templates))
    diameter_mm = table.diameter_m * MILLIMETRES
    capacity = table.side * table.side + BESIDE
    scratch = _Scratch(
        where=np.empty(capacity, np.int64),
        differences=np.empty(capacity, np.float32),
        bins=np.empty(capacity, np.int32),
        histogram=np.empty(2 * (BINS + 2), np.int32),
        near=np.empty(capacity, np.float32),
        colors=np.empty(3 * capacity, np.float32),
    )
    _check(
        table.starts, table.covered, table.places, table.values, table.side, canvas, templates, corners,
        max(TOLERANCE * diameter_mm, MIN_TOLERANCE_MM), MAX_OFFSET * diameter_mm, scratch, scores, offsets,
    )  # fmt: skip
    return scores, offsets


@jit_dividing
def _check(
    starts: Int64,
    covered: Int32,
    places: UInt16,
    values: np.ndarray,
    side: int,
    canvas: Canvas,
    templates: Int64,
    corners: Int64,
    tolerance: float,
    max_offset: float,
    scratch: _Scratch,
    scores: Float64,
    offsets: Float64,
) -> None:
    wide = canvas.relief.shape[1]
    for k in range(templates.shape[0]):
        i, x, y = templates[k], corners[k, 0], corners[k, 1]
        first, count = starts[i], starts[i + 1] - starts[i]
        _find(places, first, count, wide, y * wide + x, scratch.where)
        if _differ(values, first, count, canvas.relief.reshape(-1), max_offset, scratch) < FEWEST:
            scores[k] = NO_SCORE
            continue
        offset = offsets[k] = _mode(scratch, count, tolerance, max_offset)
        fit, fitting, occluded, violated = _agreement(scratch, count, offset, tolerance)
        color = 0.0
        if fitting >= FEWEST:
            color = _color(values, first, count, canvas.color.reshape(-1), fitting, scratch)
        box = 0.0
        if fitting > 0.0:
            box = _box_iou(places, first, count, scratch.near, side, x, y, canvas.bounds)
        judged = fitting + violated + MARGIN * covered[i]
        scores[k] = (
            (FIT_WEIGHT * fit - VIOLATION_WEIGHT * violated) / judged
            + COLOR_WEIGHT * color
            + BOX_WEIGHT * box
            - OCCLUDED_WEIGHT * occluded / covered[i]
        )


@jit_dividing
def _find(places: UInt16, first: int, count: int, wide: int, corner: int, where: Int64) -> None:
    """Fill `where` with the indices of a template's cells, from `first` on, in a flat canvas `wide` cells
    wide. The template's corner is at `corner`."""
    begin, row, origin = np.uint64(first), np.uint64(wide), np.uint64(corner)
    for n in range(np.uint64(count)):
        place = places[begin + n]
        where[n] = np.uint64(place >> np.uint16(8)) * row + np.uint64(place & np.uint16(255)) + origin


@jit_dividing
def _differ(
    values: np.ndarray, first: int, count: int, relief: Float32, max_offset: float, scratch: _Scratch
) -> int:
    """Fill differences and bins; returns how many cells are known in both. A difference beyond max_offset
    gets the first or the last bin, which are not used."""
    differences, bins = scratch.differences, scratch.bins
    row = np.uint64(4 * first + 3 * count)
    scale, middle = np.float32(BINS / (2.0 * max_offset)), np.float32(BINS / 2.0 + 1.0)
    known = np.int32(0)
    for n in range(np.uint64(count)):
        differences[n] = relief[np.uint64(scratch.where[n])]
    for n in range(np.uint64(count)):
        stored = values[row + n]
        difference = differences[n] - np.float32(stored) * np.float32(1.0 / RELIEF_STEPS)
        difference = difference if stored != NOT_COVERED else UNKNOWN_MM
        known += np.int32(1) if difference < KNOWN_MM else np.int32(0)
        differences[n] = difference
        bins[n] = np.int32(min(max(difference * scale + middle, np.float32(0.0)), np.float32(BINS + 1)))
    return int(known)


@jit_dividing
def _mode(scratch: _Scratch, count: int, tolerance: float, max_offset: float) -> float:
    """The mode of the differences within `max_offset` of 0: the maximum of the histogram, then twice the
    mean of the differences near it."""
    differences, bins, histogram = scratch.differences, scratch.bins, scratch.histogram
    one, half = np.uint64(1), np.uint64(BINS + 2)
    histogram[:] = 0
    # Two histograms in alternation: with one, each step would wait for the last one's write to the same
    # bin.
    for n in range(np.uint64(count // 2)):
        histogram[np.uint64(bins[n + n])] += 1
        histogram[half + np.uint64(bins[n + n + one])] += 1
    for b in range(half):
        histogram[b] += histogram[b + half]
    histogram[0] = histogram[BINS + 1] = 0
    # Of equally full bins, the first: the bin's number is part of the compared number.
    best = np.int32(0)
    for b in range(one, np.uint64(BINS + 1)):
        near = histogram[b - one] + histogram[b] + histogram[b + one]
        best = max(best, near * np.int32(2 * BINS) + np.int32(2 * BINS - 1) - np.int32(b))
    at = 2 * BINS - 1 - best % (2 * BINS)
    offset = np.float32((at - 0.5) / BINS * 2.0 * max_offset - max_offset)
    limit = np.float32(tolerance)
    for _ in range(2):
        total, weights = np.float32(0.0), np.float32(0.0)
        for n in range(np.uint64(count)):
            weight = np.float32(1.0) if abs(differences[n] - offset) < limit else np.float32(0.0)
            total += weight * differences[n]
            weights += weight
        if weights > 0.0:
            offset = total / weights
    return float(offset)


@jit_dividing
def _agreement(
    scratch: _Scratch, count: int, offset: float, tolerance: float
) -> tuple[float, float, float, float]:
    """Fill `near`. Returns the summed fit of the fitting cells, and how many cells fit, are occluded, and
    violate free space."""
    differences, near = scratch.differences, scratch.near
    zero, one = np.float32(0.0), np.float32(1.0)
    moved, each = np.float32(offset), np.float32(1.0 / tolerance)
    fit, fitting, occluded, violated = zero, zero, zero, zero
    for n in range(np.uint64(count)):
        difference = (differences[n] - moved) * each
        weight = one if abs(difference) < one else zero
        fit += weight * (one - difference * difference)
        fitting += weight
        occluded += one if difference <= -one else zero
        violated += one if difference >= one and differences[n] < KNOWN_MM else zero
        near[n] = weight
    return float(fit), float(fitting), float(occluded), float(violated)


@jit_dividing
def _color(
    values: np.ndarray, first: int, count: int, shown: Float32, fitting: float, scratch: _Scratch
) -> float:
    """Correlation of the opponents of a template and the canvas over the fitting cells, channels weighted by
    their contrast."""
    where, near, colors = scratch.where, scratch.near, scratch.colors
    second, third = np.uint64(count), np.uint64(2 * count)
    for n in range(np.uint64(count)):
        p = np.uint64(3) * np.uint64(where[n])
        colors[n], colors[second + n] = shown[p], shown[p + np.uint64(1)]
        colors[third + n] = shown[p + np.uint64(2)]
    zero, each, unit = np.float32(0.0), np.float32(1.0 / fitting), np.float32(1.0 / STEPS)
    agreed, weights = 0.0, PLAIN
    for q in range(np.uint64(3)):
        row, channel = np.uint64(4 * first) + q * second, q * second
        s_t, s_i, s_tt, s_ii, s_ti = zero, zero, zero, zero, zero
        for n in range(np.uint64(count)):
            a, b = near[n] * np.float32(values[row + n]) * unit, near[n] * colors[channel + n]
            s_t += a
            s_i += b
            s_tt += a * a
            s_ii += b * b
            s_ti += a * b
        mean_t, mean_i = s_t * each, s_i * each
        var_t = max(s_tt * each - mean_t * mean_t, zero)
        var_i = max(s_ii * each - mean_i * mean_i, zero)
        weight = CHANNEL_WEIGHTS[q] * np.sqrt(var_t)
        agreed += weight * (s_ti * each - mean_t * mean_i) / (np.sqrt(var_t * var_i) + CHANNEL_FLOOR)
        weights += weight
    return float(agreed / weights)


@jit_dividing
def _box_iou(
    places: UInt16, first: int, count: int, near: Float32, side: int, x: int, y: int, bounds: Float64
) -> float:
    """IoU of the bounds of the fitting cells and the box. The template's corner is at (x, y)."""
    zero, one, eight, low = np.int32(0), np.int32(1), np.int32(8), np.int32(255)
    size = np.int32(side)
    begin = np.uint64(first)
    left, right, top, bottom = zero, zero, zero, zero
    for n in range(np.uint64(count)):
        place = np.int32(places[begin + n])
        u, v = place & low, place >> eight
        fits = near[n] > np.float32(0.0)
        left, right = max(left, size - u if fits else zero), max(right, u + one if fits else zero)
        top, bottom = max(top, size - v if fits else zero), max(bottom, v + one if fits else zero)
    x0, x1, y0, y1 = x + size - left, x + right, y + size - top, y + bottom
    w = min(float(x1), bounds[2]) - max(float(x0), bounds[0])
    h = min(float(y1), bounds[3]) - max(float(y0), bounds[1])
    if w <= 0.0 or h <= 0.0:
        return 0.0
    area = (x1 - x0) * (y1 - y0) + (bounds[2] - bounds[0]) * (bounds[3] - bounds[1])
    return float(w * h / (area - w * h))
