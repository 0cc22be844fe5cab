"""The close look: score templates against the picture, without a mask.

The depth of a template is not known beforehand; it is the one at which most of its cells agree with the
picture (the mode of the differences). At this depth cells fit, are occluded (the picture is nearer) or are
seen through (the picture is farther); colours are correlated over the cells that fit. So an object that is
half hidden behind another is separated from it by depth alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int64
from huepose.judge.terms import DEFAULT_WEIGHTS
from huepose.propose.templates import MILLIMETRES, RELIEF_STEPS, STEPS, TemplateTable
from huepose.support.jit import jit_dividing

FIT_WEIGHT, VIOLATION_WEIGHT = DEFAULT_WEIGHTS.depth_fit, DEFAULT_WEIGHTS.violation
COLOR_WEIGHT, BOX_WEIGHT, OCCLUDED_WEIGHT = 0.7, 1.4, 0.1
"""Weights of the terms; depth fit and free-space violation as in `judge.terms`, the others chosen."""

LIGHTNESS_WEIGHT = 0.4
"""Of the correlation of lightness against that of the other two channels: shading is in it."""

CHANNEL_FLOOR = 3.0
"""Opponent units, added to the spreads of a channel: keeps the correlation of plain cells low."""

TOLERANCE, MIN_TOLERANCE_MM = 0.05, 8.0
"""Largest difference of a fitting cell, the larger of this share of the diameter and these millimetres."""

MAX_OFFSET = 0.75
"""Largest offset between the template's depth and the median depth of the window, in diameters."""

BINS = 64
"""Of the histogram of depth offsets."""


class Canvas(NamedTuple):
    """The picture resampled to template cells. color (n, n, 3): opponents; relief (n, n): millimetres from
    the median depth; valid (n, n): cells that have both; bounds (4,): left, top, right, bottom of the box in
    cells."""

    color: Float32
    relief: Float32
    valid: Bool
    bounds: Float64


def check_templates(
    table: TemplateTable, canvas: Canvas, templates: Int64, corners: Int64
) -> tuple[Float64, Float64]:
    """Score templates (K,) placed with their top-left cell at `corners` (K, 2) (x, y) of the canvas.

    Returns scores (K,), and the depth offset (K,) in millimetres at which each fits best."""
    scores, relief = np.zeros(len(templates)), np.zeros(len(templates))
    diameter_mm = table.diameter_m * MILLIMETRES
    tolerance = max(TOLERANCE * diameter_mm, MIN_TOLERANCE_MM)
    _check(
        table.starts, table.places, table.values, table.side, canvas, templates, corners, tolerance,
        MAX_OFFSET * diameter_mm, scores, relief,
    )  # fmt: skip
    return scores, relief


@jit_dividing
def _check(
    starts: Int64,
    places: np.ndarray,
    values: np.ndarray,
    side: int,
    canvas: Canvas,
    templates: Int64,
    corners: Int64,
    tolerance: float,
    max_offset: float,
    scores: Float64,
    relief: Float64,
) -> None:
    capacity = side * side + 1
    differences = np.empty(capacity, np.float32)
    where = np.empty((3, capacity), np.int64)
    histogram = np.empty(BINS + 2, np.int32)
    colors = np.empty((6, capacity), np.float32)
    wide = canvas.relief.shape[1]
    shown, valid = canvas.relief.flat, canvas.valid.flat
    for k in range(templates.shape[0]):
        first = starts[templates[k]]
        covered = starts[templates[k] + 1] - first
        corner = corners[k, 1] * wide + corners[k, 0]
        known = 0
        for n in range(covered):
            i = np.uint64(first + n)
            cell = np.int64(places[i])
            p = np.uint64((cell >> 8) * wide + (cell & 255) + corner)
            differences[known] = shown[p] - values[i, 3] * np.float32(1.0 / RELIEF_STEPS)
            where[0, known], where[1, known], where[2, known] = i, p, cell
            known += 1 if valid[p] else 0
        if known < 4:
            scores[k] = -9.0
            continue
        offset = _mode(differences, known, tolerance, max_offset, histogram)
        relief[k] = offset
        scores[k] = _score_template(
            values, canvas, side, corners[k], differences, where, known, offset, tolerance, covered, colors
        )


@jit_dividing
def _mode(
    differences: Float32, count: int, tolerance: float, max_offset: float, histogram: np.ndarray
) -> float:
    """The mode of the differences within `max_offset` of 0: histogram maximum, then twice the mean of those
    near it."""
    histogram[:] = 0
    scale, middle = np.float32(BINS / (2.0 * max_offset)), np.float32(BINS / 2.0 + 1.0)
    for i in range(count):
        # What is out of max_offset is counted in the first or last bin, which are not looked at.
        place = min(max(differences[i] * scale + middle, np.float32(0.0)), np.float32(BINS + 1))
        histogram[np.uint64(place)] += 1
    histogram[0] = histogram[BINS + 1] = 0
    best, at = -1, 0
    for b in range(np.uint64(1), np.uint64(BINS + 1)):
        near = histogram[b - np.uint64(1)] + histogram[b] + histogram[b + np.uint64(1)]
        if near > best:
            best, at = near, int(b)
    offset = np.float32((at - 0.5) / BINS * 2.0 * max_offset - max_offset)
    limit = np.float32(tolerance)
    for _ in range(2):
        total, n = np.float32(0.0), np.float32(0.0)
        for i in range(count):
            near_it = np.float32(1.0) if abs(differences[i] - offset) < limit else np.float32(0.0)
            total += near_it * differences[i]
            n += near_it
        if n > 0.0:
            offset = total / n
    return float(offset)


@jit_dividing
def _score_template(
    values: np.ndarray,
    canvas: Canvas,
    side: int,
    corner: Int64,
    differences: Float32,
    where: np.ndarray,
    known: int,
    offset: float,
    tolerance: float,
    covered: int,
    colors: Float32,
) -> float:
    """Score of one template at one position and depth offset.

    differences (known,): picture minus template relief in the cells that have both, millimetres; where (3,
    known): their indices in `values`, in the flat canvas and in the window; colors (6, cells): scratch
    space."""
    shown = canvas.color.flat
    fit, near, occluded, violated = 0.0, 0, 0, 0
    x0, y0, x1, y1 = side, side, -1, -1
    for k in range(known):
        difference = (differences[k] - offset) / tolerance
        occluded += 1 if difference <= -1.0 else 0
        violated += 1 if difference >= 1.0 else 0
        # Compact the fitting cells in place: only entries that were read already are overwritten.
        where[0, near], where[1, near], where[2, near] = where[0, k], where[1, k], where[2, k]
        fits = abs(difference) < 1.0
        near += 1 if fits else 0
        fit += 1.0 - difference * difference if fits else 0.0
    for k in range(near):
        i, p, cell = np.uint64(where[0, k]), np.uint64(3 * where[1, k]), where[2, k]
        x, y = cell & 255, cell >> 8
        x0, x1 = min(x0, x), max(x1, x + 1)
        y0, y1 = min(y0, y), max(y1, y + 1)
        for q in range(np.uint64(3)):
            colors[q, k] = values[i, q] * np.float32(1.0 / STEPS)
            colors[np.uint64(3) + q, k] = shown[p + q]
    color, color_weight = 0.0, 4.0
    if near >= 4:
        each = np.float32(1.0 / near)
        for q in range(3):
            zero = np.float32(0.0)
            s_t, s_i, s_tt, s_ii, s_ti = zero, zero, zero, zero, zero
            for k in range(near):
                a, b = colors[q, k], colors[3 + q, k]
                s_t += a
                s_i += b
                s_tt += a * a
                s_ii += b * b
                s_ti += a * b
            mean_t, mean_i = s_t * each, s_i * each
            var_t = max(s_tt * each - mean_t * mean_t, zero)
            var_i = max(s_ii * each - mean_i * mean_i, zero)
            w = (LIGHTNESS_WEIGHT if q == 0 else 1.0) * np.sqrt(var_t)
            color += w * (s_ti * each - mean_t * mean_i) / (np.sqrt(var_t * var_i) + CHANNEL_FLOOR)
            color_weight += w
    bounds = canvas.bounds
    w = min(float(x1 + corner[0]), bounds[2]) - max(float(x0 + corner[0]), bounds[0])
    h = min(float(y1 + corner[1]), bounds[3]) - max(float(y0 + corner[1]), bounds[1])
    iou = 0.0
    if near > 0 and w > 0.0 and h > 0.0:
        iou = w * h / ((x1 - x0) * (y1 - y0) + (bounds[2] - bounds[0]) * (bounds[3] - bounds[1]) - w * h)
    judged = near + violated + 0.15 * covered
    return float(
        FIT_WEIGHT * fit / judged
        - VIOLATION_WEIGHT * violated / judged
        + COLOR_WEIGHT * color / color_weight
        + BOX_WEIGHT * iou
        - OCCLUDED_WEIGHT * occluded / covered
    )
