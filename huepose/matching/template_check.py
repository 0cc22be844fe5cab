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
from huepose.support.jit import jit

FIT_WEIGHT, VIOLATION_WEIGHT, COLOR_WEIGHT, BOX_WEIGHT, OCCLUDED_WEIGHT = 0.9, 1.0, 0.7, 1.4, 0.1
LIGHTNESS = 0.4
COLOR_FLOOR = 3.0
TOLERANCE, MIN_TOLERANCE_MM = 0.05, 8.0
"""How far relief and depth may be apart, in diameters and in millimetres."""

REACH = 0.75
"""How far from the middle depth the window may lie, in diameters."""

BINS = 64


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


@jit
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
    histogram = np.empty(BINS)
    moments = np.empty((3, 5))
    for k in range(templates.shape[0]):
        template = cells[templates[k]]
        left, top = corners[k, 0], corners[k, 1]
        covered, known = 0, 0
        for y in range(side):
            for x in range(side):
                if template[y, x, 4] >= 0.5 * STEPS:
                    covered += 1
                    if canvas.valid[y + top, x + left]:
                        gaps[known] = canvas.relief[y + top, x + left] - template[y, x, 3] / RELIEF_STEPS
                        known += 1
        if known < 4:
            scores[k] = -9.0
            continue
        offset = _most_common(gaps, known, tolerance, reach, histogram)
        relief[k] = offset
        scores[k] = _rated(template, canvas, left, top, offset, tolerance, covered, moments)


@jit
def _most_common(gaps: Float64, count: int, tolerance: float, reach: float, histogram: Float64) -> float:
    """The value within `reach` of 0 that most gaps are near."""
    histogram[:] = 0.0
    for i in range(count):
        b = int(np.floor((gaps[i] + reach) / (2.0 * reach) * BINS))
        if 0 <= b < BINS:
            histogram[b] += 1.0
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
        total, n = 0.0, 0
        for i in range(count):
            if abs(gaps[i] - offset) < tolerance:
                total += gaps[i]
                n += 1
        if n > 0:
            offset = total / n
    return offset


@jit
def _rated(
    template: np.ndarray,
    canvas: Canvas,
    left: int,
    top: int,
    offset: float,
    tolerance: float,
    covered: int,
    moments: Float64,
) -> float:
    """Score of one template at one place and depth."""
    side = template.shape[0]
    moments[:] = 0.0
    fit, near, occluded, violated = 0.0, 0, 0, 0
    x0, y0, x1, y1 = 1e9, 1e9, -1e9, -1e9
    for y in range(side):
        for x in range(side):
            if template[y, x, 4] < 0.5 * STEPS or not canvas.valid[y + top, x + left]:
                continue
            gap = canvas.relief[y + top, x + left] - template[y, x, 3] / RELIEF_STEPS - offset
            if gap <= -tolerance:
                occluded += 1
            elif gap >= tolerance:
                violated += 1
            else:
                near += 1
                fit += 1.0 - (gap / tolerance) ** 2
                x0, x1 = min(x0, x + left), max(x1, x + left + 1.0)
                y0, y1 = min(y0, y + top), max(y1, y + top + 1.0)
                for q in range(3):
                    a, b = template[y, x, q] / STEPS, canvas.color[y + top, x + left, q]
                    moments[q, 0] += a
                    moments[q, 1] += b
                    moments[q, 2] += a * a
                    moments[q, 3] += b * b
                    moments[q, 4] += a * b
    color, color_weight = 0.0, 4.0
    if near >= 4:
        for q in range(3):
            mean_t, mean_i = moments[q, 0] / near, moments[q, 1] / near
            var_t = max(moments[q, 2] / near - mean_t * mean_t, 0.0)
            var_i = max(moments[q, 3] / near - mean_i * mean_i, 0.0)
            w = (LIGHTNESS if q == 0 else 1.0) * np.sqrt(var_t)
            color += w * (moments[q, 4] / near - mean_t * mean_i) / (np.sqrt(var_t * var_i) + COLOR_FLOOR)
            color_weight += w
    w = min(x1, canvas.bounds[2]) - max(x0, canvas.bounds[0])
    h = min(y1, canvas.bounds[3]) - max(y0, canvas.bounds[1])
    iou = 0.0
    if w > 0.0 and h > 0.0:
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
