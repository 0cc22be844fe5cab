"""Pose hypotheses by view retrieval: find the model's templates that look like the image under each mask.

The quick look (`quick_look`) compares all templates (views times rolls) with the image at nine positions
around each mask, at metric scale. The close look (`close_look`) scores the best of them without the mask.
So a mask may be wrong in detail as long as it contains the object; the whole box can serve as one. The idea
of view templates is LINEMOD's (Hinterstoisser et al. 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float, Float32, Float64, Int64, median
from huepose.geometry.camera import Camera
from huepose.geometry.suppression import first_different
from huepose.judge.region import Crop
from huepose.propose.close_look import canvas_of, check_templates
from huepose.propose.quick_look import masked_cells, nearest, quick_look, sampled
from huepose.propose.templates import COARSE_SIDE, MILLIMETRES, TemplateTable
from huepose.support.jit import jit, jit_dividing

SHIFTS = (-1, 0, 1)
"""Shifts of the window from the mask's centroid, in cells of the quick look, along both image axes."""

VIEWS = 30
"""Most hypotheses for all masks together. Chosen by recall in piles (`huepose eval estimate`)."""

CLOSER, CLOSEST = 1500, 200
"""Templates per mask that get the close look, and the best of these, which are also tried one cell to each
side. Chosen by recall in piles: 700 and 80, with fewer poses searched, lose three points there."""

QUICK_WEIGHT = 0.5
"""Weight of the quick look's score, which is added to the close look's. Chosen."""

RANKED, APART_RAD = 300, np.radians(18.0)
"""Best templates per mask that may become hypotheses; least angle between the rotations of two hypotheses.
Template directions are 16 degrees apart, so neighbours count as the same view."""

MAX_MEDIAN_PIXELS = 4000
"""Most depth readings used for the median depth of a mask: more do not change it."""


@dataclass(frozen=True, eq=False)
class Retrieved:
    """Hypotheses, best first: poses T_cam_obj (K, 4, 4), scores (K,), and masks (K,): index of the mask
    that each came from."""

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


def retrieve(
    table: TemplateTable, crop: Crop, bounds: Float64, masks: Sequence[Bool], views: int = VIEWS
) -> Retrieved:
    """The best hypotheses under candidate masks (h, w) bool of a crop; empty if no mask has a pixel with
    depth. bounds (4,): left, top, right, bottom of the object's box in the crop's pixels; views: most
    hypotheses, for all masks together."""
    known = [(k, mask & (crop.depth > 0)) for k, mask in enumerate(masks)]
    known = [(k, mask) for k, mask in known if mask.any()]
    if not known:
        return Retrieved(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, np.int64))
    places = [_place(table, crop, mask) for _, mask in known]
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
    origin = np.repeat([k for k, _ in known], [len(f.scores) for f in found])
    return Retrieved(poses[chosen], scores[order[chosen]], origin[order[chosen]])


def _place(table: TemplateTable, crop: Crop, mask: Bool) -> _Place:
    """Position, scale and windows of one mask (h, w)."""
    depths = crop.depth[mask]
    middle_m = median(depths[:: -(-len(depths) // MAX_MEDIAN_PIXELS)])
    centre = _centroid(mask)
    span = table.span_m / middle_m * crop.camera.fx
    margin = max(SHIFTS)
    wide = COARSE_SIDE + 2 * margin
    fine, color, depth, to_image = sampled(crop.color, crop.depth, centre, span / COARSE_SIDE, wide)
    inside = nearest(mask.view(np.uint8), to_image, len(depth))
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
    canvas = canvas_of(color, depth, fine, place.middle_m, bounds)

    templates = _best(quick, CLOSER)
    corners = margin + np.rint(coarse[best_shift[templates]]).astype(np.int64)
    rated, depth_mm = check_templates(table, canvas, templates, corners)
    rated += QUICK_WEIGHT * quick[templates]

    best = _best(rated, CLOSEST)
    steps = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1) if x or y])
    near = np.clip(corners[best][:, None] + steps, 0, 2 * margin).reshape(-1, 2)
    again = np.repeat(templates[best], len(steps))
    rated_again, depth_again = check_templates(table, canvas, again, near)
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
    return _placed(camera.rays(pixels), depth_m, table.rotations[templates], table.origins[templates])


@jit
def _placed(rays: Float64, depth_m: Float64, rotations: Float64, origins: Float64) -> Float64:
    """Poses (K, 4, 4) of views whose rotations (K, 3, 3) and origins (K, 3) are relative to rays (K, 3)."""
    to_rays, out = onto_rays(rays), np.zeros((len(rays), 4, 4))
    for k in range(len(rays)):
        for r in range(3):
            out[k, r, 3] = rays[k, r] * depth_m[k]
            for i in range(3):
                out[k, r, 3] += to_rays[k, r, i] * origins[k, i]
                for c in range(3):
                    out[k, r, c] += to_rays[k, r, i] * rotations[k, i, c]
        out[k, 3, 3] = 1.0
    return out


@jit
def onto_rays(rays: Float64) -> Float64:
    """The shortest rotations (K, 3, 3) that take the optical axis onto rays (K, 3)."""
    out = np.empty((len(rays), 3, 3))
    for k in range(len(rays)):
        length = np.sqrt(rays[k, 0] ** 2 + rays[k, 1] ** 2 + rays[k, 2] ** 2)
        x, y, z = rays[k, 0] / length, rays[k, 1] / length, rays[k, 2] / length
        share = 1.0 / (1.0 + z)
        out[k, 0, 0], out[k, 0, 1], out[k, 0, 2] = 1.0 - x * x * share, -x * y * share, x
        out[k, 1, 0], out[k, 1, 1], out[k, 1, 2] = -x * y * share, 1.0 - y * y * share, y
        out[k, 2, 0], out[k, 2, 1], out[k, 2, 2] = -x, -y, 1.0 - (x * x + y * y) * share
    return out
