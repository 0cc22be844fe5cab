"""Hypotheses by view: which of the model's small pictures looks like what is in the box?

A quick look compares all templates (views times rolls) with the picture at several places round each
candidate mask, at metric scale: opponent colours by correlation (so light does not matter), depth by the
deviation of its relief, coverage of the mask, and no template where the background is seen. All sums over
cells are matrix products, so thousands of templates take a few milliseconds. A close look (`template_check`)
then judges the better ones without the mask. So a mask need not be right, only the object somewhere in it:
the whole box will do for one (LINEMOD's idea of view templates, Hinterstoisser et al. 2012, with the
products of a nearest-neighbour search).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import linear_rgb, opponents
from huepose.geometry.arrays import Bool, Float32, Float64, Int64, UInt8
from huepose.geometry.camera import Camera
from huepose.matching.template_check import Canvas, check_templates
from huepose.matching.template_table import COARSE_SIDE, MILLIMETRES, TemplateTable
from huepose.support.jit import jit_dividing

SHIFTS = (-1, 0, 1)
"""Places of the window round the mask's centroid, in cells of the quick look, along both image axes."""

RELIEF = 0.05
"""Deviation of relief, in diameters, at which the depth term has fallen to 0.6."""

CHANNEL_WEIGHTS = (0.35, 1.0, 1.0)
CHANNEL_FLOOR = 9.0
DEPTH_WEIGHT, OVERLAP_WEIGHT, FREE_WEIGHT, FULL_WEIGHT = 0.8, 1.0, 0.8, 0.3
CLOSER, CLOSEST = 1500, 200
"""Templates a mask that get the close look, and that are tried a cell to each side, unless said otherwise."""

QUICK_WEIGHT = 0.5
"""What the quick look's score counts beside the close look's."""

RANKED = 300
MAX_PRODUCT = 4 * 65536
"""Multiplications up to which OpenBLAS keeps a matrix product in one thread."""

DISTINCT_RAD = np.radians(18.0)
OVERSAMPLING = 4
"""At most so many samples a cell and axis are averaged."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Where to look. color (h, w, 3) uint8 RGB, depth (h, w) float32 metres, with their camera; bounds (4,):
    left, top, right, bottom of the object's box in its pixels."""

    color: UInt8
    depth: Float32
    camera: Camera
    bounds: Float64


@dataclass(frozen=True, eq=False)
class Retrieved:
    """Different views, best first: poses T_cam_obj (K, 4, 4), scores (K,), and the mask (K,) that each came
    from."""

    poses: Float64
    scores: Float64
    masks: Int64


def retrieve(
    table: TemplateTable,
    picture: Picture,
    masks: Sequence[Bool],
    count: int,
    closer: tuple[int, int] = (CLOSER, CLOSEST),
) -> Retrieved:
    """The `count` best views under candidate masks (h, w), rotations at least 18 degrees apart; none where
    no mask has a pixel with depth. closer: templates a mask that get the close look, and that are tried a
    cell to each side."""
    poses, scores, origin = [np.zeros((0, 4, 4))], [np.zeros(0)], [np.zeros(0, np.int64)]
    for k, mask in enumerate(masks):
        seen = mask & (picture.depth > 0)
        if seen.any():
            found, rated = _under_mask(table, picture, seen, *closer)
            poses.append(found)
            scores.append(rated)
            origin.append(np.full(len(found), k))
    every, rates = np.concatenate(poses), np.concatenate(scores)
    order = np.argsort(-rates, kind="stable")
    chosen = order[distinct(every[order], count)]
    return Retrieved(every[chosen], rates[chosen], np.concatenate(origin)[chosen])


def distinct(poses: Float64, count: int) -> list[int]:
    """Indices of the first poses (N, 4, 4) whose rotations are 18 degrees or more from all chosen before."""
    flat = poses[:, :3, :3].reshape(len(poses), 9)
    limit = 1.0 + 2.0 * np.cos(DISTINCT_RAD)
    return [int(i) for i in _distinct(np.ascontiguousarray(flat), limit, count)]


@jit_dividing
def _distinct(flat: Float64, limit: float, count: int) -> Int64:
    chosen = np.empty(min(count, len(flat)), np.int64)
    n = 0
    for i in range(len(flat)):
        if n == len(chosen):
            break
        is_new = True
        for k in range(n):
            trace = 0.0
            for c in range(9):
                trace += flat[chosen[k], c] * flat[i, c]
            if trace >= limit:
                is_new = False
                break
        if is_new:
            chosen[n] = i
            n += 1
    return chosen[:n]


def _under_mask(
    table: TemplateTable, picture: Picture, mask: Bool, closer: int, closest: int
) -> tuple[Float64, Float64]:
    """The best poses (K, 4, 4) and their scores (K,) round one mask."""
    middle_m = float(np.median(picture.depth[mask]))
    rows, columns = np.nonzero(mask)
    centre = np.array([columns.mean(), rows.mean()])
    span = table.span_m / middle_m * picture.camera.fx
    windows = _windows(picture, mask, centre, span / COARSE_SIDE, middle_m, table.diameter_m)
    which, quick = _quick_look(table, windows)

    ranked = np.argsort(-quick, kind="stable")[:closer]
    side = table.cells.shape[1]
    places = np.array([(x, y) for y in SHIFTS for x in SHIFTS]) * (side / COARSE_SIDE)
    shifts = np.rint(places[which[ranked]]).astype(np.int64)
    margin = int(np.abs(places).max()) + 1
    canvas = _canvas(picture, centre, span / side, side + 2 * margin, middle_m)
    rated, depth_mm = check_templates(table, canvas, ranked, shifts, margin)
    rated += QUICK_WEIGHT * quick[ranked]

    best = np.argsort(-rated, kind="stable")[:closest]
    steps = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)])
    near = np.clip(shifts[best][:, None] + steps, -margin, margin).reshape(-1, 2)
    again = np.repeat(ranked[best], len(steps))
    rated_again, depth_again = check_templates(table, canvas, again, near, margin)
    rated_again += QUICK_WEIGHT * np.repeat(quick[ranked[best]], len(steps))

    templates, shifts = np.concatenate([ranked, again]), np.concatenate([shifts, near])
    rated, depth_mm = np.concatenate([rated, rated_again]), np.concatenate([depth_mm, depth_again])
    best = np.argsort(-rated, kind="stable")[:RANKED]
    pixels = centre + shifts[best] * (span / side)
    depth_m = middle_m + depth_mm[best] / MILLIMETRES
    return _poses(table, templates[best], pixels, depth_m, picture.camera), rated[best]


def _poses(
    table: TemplateTable, templates: Int64, pixels: Float64, depth_m: Float64, camera: Camera
) -> Float64:
    """Poses (K, 4, 4) of templates whose windows' middles lie at pixels (K, 2) and depths (K,)."""
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


def _sampled(
    picture: Picture, centre: Float64, cell: float, cells: int
) -> tuple[int, Float32, Float32, Float64]:
    """Linear colours and depth on a fine lattice of `cells` cells a side about a pixel: samples a cell and
    axis, (n, n, 3), (n, n), and the map (2, 3) from the lattice to the picture."""
    fine = max(1, min(OVERSAMPLING, round(cell)))
    step, n = cell / fine, cells * fine
    to_picture = np.array(
        [[step, 0.0, centre[0] - (n - 1) / 2 * step], [0.0, step, centre[1] - (n - 1) / 2 * step]]
    )
    color = cv2.warpAffine(picture.color, to_picture, (n, n), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return (
        fine,
        linear_rgb(np.asarray(color, dtype=np.uint8)),
        _nearest(picture.depth, to_picture, n),
        to_picture,
    )


def _nearest(image: Float32, to_picture: Float64, n: int) -> Float32:
    sampled = cv2.warpAffine(image, to_picture, (n, n), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
    return np.asarray(sampled, dtype=np.float32)


def _cell_means(samples: Float32, fine: int) -> Float32:
    """Means over cells of fine * fine samples: (n, n, c) to (n / fine, n / fine, c)."""
    n = samples.shape[0] // fine
    return np.asarray(samples.reshape(n, fine, n, fine, -1).mean((1, 3)), dtype=np.float32)


def _windows(
    picture: Picture, mask: Bool, centre: Float64, cell: float, middle_m: float, diameter_m: float
) -> Float32:
    """The picture in cells of the quick look at all places: (W, P, 6): opponents, relief in mm, coverage by
    the mask, background."""
    margin = max(SHIFTS)
    wide = COARSE_SIDE + 2 * margin
    fine, linear, depth, to_picture = _sampled(picture, centre, cell, wide)
    inside = _nearest(mask.astype(np.float32), to_picture, len(depth)) * (depth > 0)
    behind = (1 - inside) * (depth > middle_m - 0.1 * diameter_m)
    planes = np.dstack([linear * inside[..., None], (depth - np.float32(middle_m)) * inside, inside, behind])
    cells = _cell_means(planes, fine)
    covered = np.where(cells[..., 4] > 0.3, cells[..., 4], np.float32(0))
    values = cells[..., :4] / np.maximum(cells[..., 4:5], np.float32(1e-3))
    known = (covered > 0)[..., None]
    cells[..., :3] = np.where(known, opponents(values[..., :3]), np.float32(0))
    cells[..., 3:4] = np.where(known, values[..., 3:] * np.float32(MILLIMETRES), np.float32(0))
    cells[..., 4] = covered
    starts = [(margin + x, margin + y) for y in SHIFTS for x in SHIFTS]
    return np.stack([cells[y : y + COARSE_SIDE, x : x + COARSE_SIDE].reshape(-1, 6) for x, y in starts])


def _canvas(picture: Picture, centre: Float64, cell: float, cells: int, middle_m: float) -> Canvas:
    """The picture in cells of the close look, without any mask."""
    fine, linear, depth, _ = _sampled(picture, centre, cell, cells)
    valid = (depth > 0).astype(np.float32)
    means = _cell_means(np.dstack([linear * valid[..., None], valid]), fine)
    share = means[..., 3]
    color = opponents(means[..., :3] / np.maximum(share, np.float32(1e-3))[..., None])
    # One reading in the middle of a cell: means across a depth step would lie on no surface.
    smooth = np.asarray(cv2.medianBlur(depth, 3), dtype=np.float32)[fine // 2 :: fine, fine // 2 :: fine]
    bounds = (picture.bounds - np.concatenate([centre, centre])) / cell + cells / 2.0
    relief = (smooth - np.float32(middle_m)) * np.float32(MILLIMETRES)
    return Canvas(color, relief, (smooth > 0) & (share > 0.3), bounds)


def _quick_look(table: TemplateTable, windows: Float32) -> tuple[Int64, Float32]:
    """Index of the best window and its score, for each template."""
    count = len(windows)
    weight = windows[..., 4]
    values = [windows[..., c] for c in range(4)]
    columns = [weight, windows[..., 5]] + [weight * x for x in values] + [weight * x * x for x in values]
    by_coverage = _product(table.coverage, np.concatenate(columns).T)
    crossed = np.stack(
        [_product(table.first[c], np.concatenate([weight, weight * values[c]]).T) for c in range(4)]
    )
    squared = np.stack([_product(table.second[c], weight.T) for c in range(4)])
    which, scores = np.zeros(len(table.area), np.int64), np.zeros(len(table.area), np.float32)
    window_area = np.maximum(weight.sum(1), np.float32(1))
    relief_mm = RELIEF * table.diameter_m * MILLIMETRES
    _score_windows(by_coverage, crossed, squared, table.area, window_area, count, relief_mm, which, scores)
    return which, scores


def _product(table: Float32, columns: Float32) -> Float32:
    """The matrix product in pieces, each too small for the linear algebra library to call threads, which
    would cost several times what they give."""
    columns = np.ascontiguousarray(columns)
    out = np.empty((len(table), columns.shape[1]), np.float32)
    rows = max(8, MAX_PRODUCT // columns.size)
    for start in range(0, len(table), rows):
        np.matmul(table[start : start + rows], columns, out=out[start : start + rows])
    return out


@jit_dividing
def _score_windows(
    by_coverage: Float32,
    crossed: Float32,
    squared: Float32,
    template_area: Float32,
    window_area: Float32,
    count: int,
    relief_mm: float,
    which: Int64,
    scores: Float32,
) -> None:
    """Best of `count` windows for each template from the products' columns."""
    without_depth, deviation = np.empty(count), np.empty(count)
    sharpness = 1.0 / (2.0 * relief_mm * relief_mm)
    for i in range(template_area.shape[0]):
        area = max(template_area[i], np.float32(1.0))
        for k in range(count):
            n = by_coverage[i, k]
            common = 1.0 / max(n, np.float32(1.0))
            color, color_weight = 0.0, 2.0
            for c in range(4):
                mean_w = by_coverage[i, (2 + c) * count + k] * common
                mean_t = crossed[c, i, k] * common
                var_w = max(by_coverage[i, (6 + c) * count + k] * common - mean_w * mean_w, 0.0)
                var_t = max(squared[c, i, k] * common - mean_t * mean_t, 0.0)
                covariance = crossed[c, i, count + k] * common - mean_w * mean_t
                if c < 3:
                    w = CHANNEL_WEIGHTS[c] * np.sqrt(var_t)
                    color += w * covariance / (np.sqrt(var_w * var_t) + CHANNEL_FLOOR)
                    color_weight += w
                else:
                    deviation[k] = max(var_w + var_t - 2.0 * covariance, 0.0)
            without_depth[k] = (
                color / color_weight
                + OVERLAP_WEIGHT * n / window_area[k]
                - FREE_WEIGHT * by_coverage[i, count + k] / area
                + FULL_WEIGHT * n / area
            )
        best = -1e9
        for k in range(count):
            if without_depth[k] + DEPTH_WEIGHT <= best:
                continue  # Not even a perfect relief would help.
            total = without_depth[k] + DEPTH_WEIGHT * np.exp(-deviation[k] * sharpness)
            if total > best:
                best = total
                which[i] = k
        scores[i] = best
