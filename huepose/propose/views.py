"""Pose hypotheses by view retrieval: find the model's templates that look like the picture under each mask.

The quick look (`quick_look`) compares all templates (views times rolls) with the picture at nine positions
around each mask, at metric scale. The close look scores the best of them without the mask. So a mask may be
wrong in detail as long as it contains the object; the whole box can serve as one. The idea of view templates
is LINEMOD's (Hinterstoisser et al. 2012).

In the close look the depth of a template is the one at which most of its cells agree with the picture (the
mode of the differences). At this depth cells fit, are occluded (the picture is nearer) or are seen through
(the picture is farther); colours are correlated over the cells that fit. So an object that is half hidden
behind another is separated from it by depth alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Bool, Float, Float32, Float64, Int64, median
from huepose.geometry.camera import Camera
from huepose.geometry.suppression import first_different
from huepose.judge.region import Crop
from huepose.judge.terms import DEFAULT_WEIGHTS
from huepose.propose.quick_look import known_cells, masked_cells, nearest, quick_look, sampled
from huepose.propose.templates import COARSE_SIDE, MILLIMETRES, RELIEF_STEPS, STEPS, TemplateTable
from huepose.support.jit import jit_dividing

SHIFTS = (-1, 0, 1)
"""Shifts of the window from the mask's centroid, in cells of the quick look, along both image axes."""

VIEWS = 30
"""Hypotheses for all masks together. Chosen by recall in piles (`huepose eval estimate`)."""

CLOSER, CLOSEST = 1500, 200
"""Templates per mask that get the close look, and the best of these, which are also tried one cell to each
side. Chosen by recall in piles: 700 and 80, with fewer poses searched, lose three points there."""

QUICK_WEIGHT = 0.5
"""Of the score of the quick look, added to the close look's. Chosen."""

RANKED, APART_RAD = 300, np.radians(18.0)
"""Best templates per mask that may become hypotheses; least angle between the rotations of two hypotheses:
template directions are 16 degrees apart, so that neighbours count as the same view."""

MAX_MEDIAN_PIXELS = 4000
"""Depth readings used for the median depth of a mask: more do not change it."""

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


@dataclass(frozen=True, eq=False)
class Retrieved:
    """Hypotheses, best first: poses T_cam_obj (K, 4, 4), scores (K,), and masks (K,): index of the mask each
    came from."""

    poses: Float64
    scores: Float64
    masks: Int64


@dataclass(frozen=True, eq=False)
class _Place:
    """Position and scale from one mask. centre (2,): its centroid, pixels; span: width of a template there,
    pixels; middle_m: median depth; windows (W, P, 6): cells of the quick look at each shift."""

    centre: Float64
    span: float
    middle_m: float
    windows: Float32


@dataclass(frozen=True, eq=False)
class _Ranked:
    """The best templates (K,) of one mask, with their centre pixels (K, 2), depths (K,) and scores (K,)."""

    templates: Int64
    pixels: Float64
    depth_m: Float64
    scores: Float64


class _Canvas(NamedTuple):
    """The picture resampled to template cells. color (n, n, 3): opponents; relief (n, n): millimetres from
    the median depth; valid (n, n): cells that have both; bounds (4,): left, top, right, bottom of the box in
    cells."""

    color: Float32
    relief: Float32
    valid: Bool
    bounds: Float64


def retrieve(
    table: TemplateTable, crop: Crop, bounds: Float64, masks: Sequence[Bool], views: int = VIEWS
) -> Retrieved:
    """The best hypotheses under candidate masks (h, w) bool of a crop; empty where no mask has a pixel with
    depth. bounds (4,): left, top, right, bottom of the object's box in the crop's pixels; views: the most of
    them, for all masks together."""
    seen = [(k, mask & (crop.depth > 0)) for k, mask in enumerate(masks)]
    seen = [(k, mask) for k, mask in seen if mask.any()]
    if not seen:
        return Retrieved(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, np.int64))
    places = [_place(table, crop, mask) for _, mask in seen]
    best_shift, quick = quick_look(table, np.concatenate([p.windows for p in places]), len(SHIFTS) ** 2)
    found = [
        _close_look(table, crop, bounds, p, w, q) for p, w, q in zip(places, best_shift, quick, strict=True)
    ]
    scores = np.concatenate([f.scores for f in found])
    order = np.argsort(-scores, kind="stable")
    poses = _poses(
        table,
        np.concatenate([f.templates for f in found])[order],
        np.concatenate([f.pixels for f in found])[order],
        np.concatenate([f.depth_m for f in found])[order],
        crop.camera,
    )
    chosen = first_different(poses, APART_RAD, views)
    origin = np.repeat([k for k, _ in seen], [len(f.scores) for f in found])
    return Retrieved(poses[chosen], scores[order[chosen]], origin[order[chosen]])


def _place(table: TemplateTable, crop: Crop, mask: Bool) -> _Place:
    """Position, scale and windows of one mask (h, w)."""
    depths = crop.depth[mask]
    middle_m = median(depths[:: -(-len(depths) // MAX_MEDIAN_PIXELS)])
    centre = _centroid(mask)
    span = table.span_m / middle_m * crop.camera.fx
    margin = max(SHIFTS)
    wide = COARSE_SIDE + 2 * margin
    fine, color, depth, to_picture = sampled(crop.color, crop.depth, centre, span / COARSE_SIDE, wide)
    inside = nearest(mask.view(np.uint8), to_picture, len(depth))
    cells = masked_cells(color, depth, inside, fine, middle_m, middle_m - 0.1 * table.diameter_m)
    starts = [(margin + x, margin + y) for y in SHIFTS for x in SHIFTS]
    windows = [cells[y : y + COARSE_SIDE, x : x + COARSE_SIDE].reshape(-1, 6) for x, y in starts]
    return _Place(centre, span, middle_m, np.stack(windows))


@jit_dividing
def _centroid(mask: Bool) -> Float64:
    """Mean column and row (2,) of the pixels of a mask (h, w)."""
    count, across, down = 0, 0, 0
    for v in range(mask.shape[0]):
        row, sums = 0, 0
        for u in range(mask.shape[1]):
            inside = 1 if mask[v, u] else 0
            row += inside
            sums += inside * u
        count += row
        across += sums
        down += row * v
    return np.array([across / count, down / count])


def _close_look(
    table: TemplateTable, crop: Crop, bounds: Float64, place: _Place, best_shift: Int64, quick: Float32
) -> _Ranked:
    """The best templates at one mask. best_shift (N,): the best window of each template in the quick look;
    quick (N,): its score there."""
    side = table.side
    coarse = np.array([(x, y) for y in SHIFTS for x in SHIFTS]) * (side / COARSE_SIDE)
    margin = int(np.abs(coarse).max()) + 1
    wide, cell = side + 2 * margin, place.span / side
    fine, color, depth, _ = sampled(crop.color, crop.depth, place.centre, cell, wide)
    bounds = (bounds - np.concatenate([place.centre, place.centre])) / cell + wide / 2.0
    canvas = _Canvas(*known_cells(color, depth, fine, place.middle_m), bounds)

    templates = _best(quick, CLOSER)
    corners = margin + np.rint(coarse[best_shift[templates]]).astype(np.int64)
    rated, depth_mm = _check_templates(table, canvas, templates, corners)
    rated += QUICK_WEIGHT * quick[templates]

    best = _best(rated, CLOSEST)
    steps = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1) if x or y])
    near = np.clip(corners[best][:, None] + steps, 0, 2 * margin).reshape(-1, 2)
    again = np.repeat(templates[best], len(steps))
    rated_again, depth_again = _check_templates(table, canvas, again, near)
    rated_again += QUICK_WEIGHT * quick[again]

    templates, corners = np.concatenate([templates, again]), np.concatenate([corners, near])
    rated, depth_mm = np.concatenate([rated, rated_again]), np.concatenate([depth_mm, depth_again])
    best = _best(rated, RANKED)
    pixels = place.centre + (corners[best] - margin) * cell
    return _Ranked(templates[best], pixels, place.middle_m + depth_mm[best] / MILLIMETRES, rated[best])


def _best(scores: Float, count: int) -> Int64:
    """Indices (K,) of the `count` largest scores (N,), ascending; deterministic."""
    if count >= len(scores):
        return np.arange(len(scores))
    return np.sort(np.argpartition(scores, len(scores) - count)[len(scores) - count :])


def _poses(
    table: TemplateTable, templates: Int64, pixels: Float64, depth_m: Float64, camera: Camera
) -> Float64:
    """T_cam_obj (K, 4, 4) of templates (K,) whose windows are centred at pixels (K, 2) and depths (K,)."""
    rays = camera.rays(pixels)
    turns = onto_rays(rays)
    poses = np.tile(np.eye(4), (len(templates), 1, 1))
    poses[:, :3, :3] = turns @ table.rotations[templates]
    poses[:, :3, 3] = rays * depth_m[:, None] + np.einsum("nij,nj->ni", turns, table.origins[templates])
    return poses


def onto_rays(rays: Float64) -> Float64:
    """The shortest rotations (K, 3, 3) that take the optical axis onto rays (K, 3)."""
    d = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    K = np.zeros((len(d), 3, 3))
    K[:, 0, 2], K[:, 1, 2] = d[:, 0], d[:, 1]
    K[:, 2, 0], K[:, 2, 1] = -d[:, 0], -d[:, 1]
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + d[:, 2])[:, None, None])


def _check_templates(
    table: TemplateTable, canvas: _Canvas, templates: Int64, corners: Int64
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
    canvas: _Canvas,
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
    canvas: _Canvas,
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
