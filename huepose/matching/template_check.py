"""A close look at templates, without a mask: where does the picture's depth agree, what is in front, what is
seen through, and do the colours agree where the depth does?

The depth of a template's window is not known beforehand; it is the one at which most of its cells agree. So
an object half hidden behind another is told from it by its relief alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int64
from huepose.matching.template_table import MILLIMETRES, RELIEF_STEPS, STEPS, TemplateTable
from huepose.support.jit import jit_dividing

FIT_WEIGHT, VIOLATION_WEIGHT, COLOR_WEIGHT, BOX_WEIGHT, OCCLUDED_WEIGHT = 0.9, 1.0, 0.7, 1.4, 0.1
LIGHTNESS = 0.4
COLOR_FLOOR = 3.0
TOLERANCE, MIN_TOLERANCE_MM = 0.05, 8.0
"""How far relief and depth may be apart, in diameters and in millimetres."""

REACH = 0.75
"""How far from the middle depth the window may lie, in diameters."""

BINS = 64
COVERED_STEPS = 0.5 * STEPS
"""Coverage from which a template's cell counts, as stored."""


class Canvas(NamedTuple):
    """The picture in template cells. color (n, n, 3): opponents; relief (n, n): millimetres from the middle
    depth; valid (n, n): cells that have both; bounds (4,): the box, in cells."""

    color: Float32
    relief: Float32
    valid: Bool
    bounds: Float64


def check_templates(
    table: TemplateTable, canvas: Canvas, templates: Int64, shifts: Int64, margin: int
) -> tuple[Float64, Float64]:
    """Scores (K,) of templates (K,) whose windows begin `margin` + shift (K, 2) cells from the canvas's
    corner, and the relief (K,) in millimetres at which they agree with the depth best."""
    scores, relief = np.zeros(len(templates)), np.zeros(len(templates))
    diameter_mm = table.diameter_m * MILLIMETRES
    tolerance = max(TOLERANCE * diameter_mm, MIN_TOLERANCE_MM)
    _check(
        table.cells, canvas, templates, shifts + margin, tolerance, REACH * diameter_mm, scores, relief
    )  # fmt: skip
    return scores, relief


@jit_dividing
def _check(
    cells: np.ndarray,
    canvas: Canvas,
    templates: Int64,
    corners: Int64,
    tolerance: float,
    reach: float,
    scores: Float64,
    relief: Float64,
) -> None:
    side = cells.shape[1]
    gaps = np.empty(side * side)
    where = np.empty((side * side, 2), np.uint64)
    histogram = np.empty(BINS)
    colors = np.empty((6, side * side))
    wide = canvas.relief.shape[1]
    shown, valid = canvas.relief.ravel(), canvas.valid.ravel()
    for k in range(templates.shape[0]):
        template = cells[templates[k]].ravel()
        left, top = corners[k, 0], corners[k, 1]
        covered, known = 0, 0
        for y in range(side):
            for x in range(side):
                i = np.uint64(5 * (y * side + x))
                if template[i + np.uint64(4)] >= COVERED_STEPS:
                    covered += 1
                    p = np.uint64((y + top) * wide + x + left)
                    if valid[p]:
                        gaps[known] = shown[p] - template[i + np.uint64(3)] * (1.0 / RELIEF_STEPS)
                        where[known, 0], where[known, 1] = i, p
                        known += 1
        if known < 4:
            scores[k] = -9.0
            continue
        offset = _most_common(gaps, known, tolerance, reach, histogram)
        relief[k] = offset
        scores[k] = _rated(template, canvas, gaps, where, known, offset, tolerance, covered, colors)


@jit_dividing
def _most_common(gaps: Float64, count: int, tolerance: float, reach: float, histogram: Float64) -> float:
    """The value within `reach` of 0 that most gaps are near."""
    histogram[:] = 0.0
    scale = BINS / (2.0 * reach)
    for i in range(count):
        place = (gaps[i] + reach) * scale
        if 0.0 <= place < BINS:
            histogram[np.uint64(place)] += 1.0
    best, offset = -1.0, 0.0
    for b in range(BINS):
        near = histogram[b]
        if b > 0:
            near += histogram[b - 1]
        if b < BINS - 1:
            near += histogram[b + 1]
        if near > best:
            best, offset = near, (b + 0.5) / BINS * 2.0 * reach - reach
    for _ in range(2):
        total, n = 0.0, 0.0
        for i in range(count):
            near = 1.0 if abs(gaps[i] - offset) < tolerance else 0.0
            total += near * gaps[i]
            n += near
        if n > 0.0:
            offset = total / n
    return offset


@jit_dividing
def _rated(
    template: np.ndarray,
    canvas: Canvas,
    gaps: Float64,
    where: np.ndarray,
    known: int,
    offset: float,
    tolerance: float,
    covered: int,
    colors: Float64,
) -> float:
    """Score of one template at one place and depth. gaps (known,): between depth and relief in the cells that
    have both, `where` (known, 2): their places in the flat template and canvas; `colors` (6, cells) is
    scratch."""
    wide = np.uint64(canvas.relief.shape[1])
    shown = canvas.color.ravel()
    fit, near, occluded, violated = 0.0, 0, 0, 0
    x0, y0, x1, y1 = 1 << 30, 1 << 30, -1, -1
    for k in range(known):
        gap = gaps[k] - offset
        if gap <= -tolerance:
            occluded += 1
        elif gap >= tolerance:
            violated += 1
        else:
            i, p = where[k, 0], where[k, 1]
            fit += 1.0 - (gap / tolerance) ** 2
            x, y = int(p % wide), int(p // wide)
            x0, x1 = min(x0, x), max(x1, x + 1)
            y0, y1 = min(y0, y), max(y1, y + 1)
            for q in range(np.uint64(3)):
                colors[q, near] = template[i + q] * (1.0 / STEPS)
                colors[np.uint64(3) + q, near] = shown[np.uint64(3) * p + q]
            near += 1
    color, color_weight = 0.0, 4.0
    if near >= 4:
        for q in range(3):
            s_t, s_i, s_tt, s_ii, s_ti = 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(near):
                a, b = colors[q, k], colors[3 + q, k]
                s_t += a
                s_i += b
                s_tt += a * a
                s_ii += b * b
                s_ti += a * b
            mean_t, mean_i = s_t / near, s_i / near
            var_t = max(s_tt / near - mean_t * mean_t, 0.0)
            var_i = max(s_ii / near - mean_i * mean_i, 0.0)
            w = (LIGHTNESS if q == 0 else 1.0) * np.sqrt(var_t)
            color += w * (s_ti / near - mean_t * mean_i) / (np.sqrt(var_t * var_i) + COLOR_FLOOR)
            color_weight += w
    w = min(float(x1), canvas.bounds[2]) - max(float(x0), canvas.bounds[0])
    h = min(float(y1), canvas.bounds[3]) - max(float(y0), canvas.bounds[1])
    iou = 0.0
    if near > 0 and w > 0.0 and h > 0.0:
        box = (canvas.bounds[2] - canvas.bounds[0]) * (canvas.bounds[3] - canvas.bounds[1])
        iou = w * h / ((x1 - x0) * (y1 - y0) + box - w * h)
    judged = near + violated + 0.15 * covered
    return float(
        FIT_WEIGHT * fit / judged
        - VIOLATION_WEIGHT * violated / judged
        + COLOR_WEIGHT * color / color_weight
        + BOX_WEIGHT * iou
        - OCCLUDED_WEIGHT * occluded / covered
    )
