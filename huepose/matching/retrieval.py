"""Hypotheses by view: which of the model's small pictures looks like what is under the mask?

Every template (view times roll) is laid over the picture at several places round the mask, at metric scale,
and compared where both have pixels: colours by normalised correlation (so light does not matter), depth by
the deviation of its relief, coverage of the mask, and no template where the background is seen. All sums
over pixels are matrix products, so thousands of templates take a few milliseconds (LINEMOD's idea of view
templates, Hinterstoisser et al. 2012, with the products of a nearest-neighbour search).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.geometry.camera import Camera
from huepose.geometry.icosphere import look_at
from huepose.model.types import ViewTemplates
from huepose.support.jit import jit

TABLE_SIDE = 12
"""Templates are reduced to this side for the search."""

SHIFTS = (-2, -1, 0, 1, 2)
"""Places of the window round the mask's centroid, in template cells, along both image axes."""

RELIEF = 0.05
"""Deviation of relief, in diameters, at which the depth term has fallen to 0.6."""

CHANNEL_WEIGHTS = (0.35, 1.0, 1.0)
CHANNEL_FLOOR = 9.0
DEPTH_WEIGHT, OVERLAP_WEIGHT, FREE_WEIGHT, FULL_WEIGHT = 0.8, 1.0, 0.8, 0.3
CONSIDERED = 400
DISTINCT_RAD = np.radians(18.0)
MILLIMETRES = 1000.0


@dataclass(frozen=True, eq=False)
class TemplateTable:
    """A model's templates as matrices over pixels (P = side * side), built once (about 15 MB).

    coverage, first[c], second[c] (V * R, P) float32: weight, weight times value, weight times value squared,
    for L, a, b and relief in millimetres; area (V * R,): sum of coverage; rotations (V * R, 3, 3) and
    origins (V * R, 3): R_cam_obj and the object's origin as seen from the window's middle at median depth;
    span_m: the window's side.
    """

    side: int
    coverage: Float32
    first: tuple[Float32, ...]
    second: tuple[Float32, ...]
    area: Float32
    rotations: Float64
    origins: Float64
    span_m: float
    diameter_m: float


def build_table(templates: ViewTemplates, diameter_m: float) -> TemplateTable:
    """Reduce a model's templates and lay them out for products."""
    views, rolls = templates.planes.shape[:2]
    planes = templates.planes.reshape(views * rolls, *templates.planes.shape[2:]).astype(np.float32)
    planes[:, :4] *= planes[:, 4:]  # the mean over a cell is weighted by coverage
    mean = _averaging(planes.shape[-1])
    small = mean @ planes @ mean.T
    coverage = small[:, 4:]
    values = small[:, :4] / np.maximum(coverage, 1e-3)
    values[:, 3] *= MILLIMETRES
    flat = np.where(coverage > 0.5, coverage, 0.0).reshape(views * rolls, -1).astype(np.float32)
    values = values.reshape(views * rolls, 4, -1).astype(np.float32)
    rotations = np.empty((views, rolls, 3, 3))
    origins = np.empty((views, rolls, 3))
    for v in range(views):
        R_view = look_at(templates.directions[v])
        for r in range(rolls):
            roll = _roll(2 * np.pi * r / rolls)
            rotations[v, r] = roll @ R_view
            origins[v, r] = roll @ templates.origins[v]
    return TemplateTable(
        TABLE_SIDE,
        flat,
        tuple(np.ascontiguousarray(flat * values[:, c]) for c in range(4)),
        tuple(np.ascontiguousarray(flat * values[:, c] ** 2) for c in range(4)),
        flat.sum(1),
        rotations.reshape(-1, 3, 3),
        origins.reshape(-1, 3),
        templates.span * diameter_m,
        diameter_m,
    )


def _averaging(side: int) -> Float32:
    """Matrix (TABLE_SIDE, side) whose rows average the cells that fall into each larger cell."""
    edges = np.arange(TABLE_SIDE + 1) * (side / TABLE_SIDE)
    low, high = edges[:-1, None], edges[1:, None]
    cell = np.arange(side)[None, :]
    shared = np.clip(np.minimum(high, cell + 1) - np.maximum(low, cell), 0.0, None)
    return np.asarray(shared / (high - low), dtype=np.float32)


def _roll(angle: float) -> Float64:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def lab_of(color: UInt8) -> Float32:
    """CIELAB (..., 3) float32, L 0..100, of sRGB bytes (H, W, 3)."""
    return np.asarray(cv2.cvtColor(color.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2Lab), np.float32)


def retrieve(
    table: TemplateTable, lab: Float32, depth: Float32, mask: Bool, camera: Camera, count: int
) -> tuple[Float64, Float64]:
    """The `count` best different views under a mask.

    lab (h, w, 3), depth (h, w) metres, mask (h, w) of a picture with the given camera. Returns poses
    T_cam_obj (K, 4, 4), rotations at least 18 degrees apart, and their scores (K,), best first; none for an
    empty mask.
    """
    mask = mask & (depth > 0)
    if not mask.any():
        return np.zeros((0, 4, 4)), np.zeros(0)
    middle_m = float(np.median(depth[mask]))
    windows, pixels = _windows(table, lab, depth, mask, camera, middle_m)
    which, scores = _best_window(table, windows)
    ranked = np.argsort(-scores, kind="stable")[:CONSIDERED]
    rays = camera.rays(pixels)
    poses = np.tile(np.eye(4), (len(ranked), 1, 1))
    turns = np.stack([_onto_ray(ray) for ray in rays])
    window = which[ranked]
    poses[:, :3, :3] = turns[window] @ table.rotations[ranked]
    poses[:, :3, 3] = rays[window] * middle_m + np.einsum("nij,nj->ni", turns[window], table.origins[ranked])
    chosen = distinct(poses, count)
    return poses[chosen], scores[ranked[chosen]].astype(np.float64)


def distinct(poses: Float64, count: int) -> list[int]:
    """Indices of the first poses (N, 4, 4) whose rotations are 18 degrees or more from all chosen before."""
    flat = poses[:, :3, :3].reshape(len(poses), 9)
    limit = 1.0 + 2.0 * np.cos(DISTINCT_RAD)
    chosen: list[int] = []
    for i in range(len(poses)):
        if not chosen or (flat[chosen] @ flat[i]).max() < limit:
            chosen.append(i)
            if len(chosen) == count:
                break
    return chosen


def _windows(
    table: TemplateTable, lab: Float32, depth: Float32, mask: Bool, camera: Camera, middle_m: float
) -> tuple[Float32, Float64]:
    """The picture resampled to template cells at all places: (W, P, 6) L, a, b, relief in mm, coverage,
    background; and the pixel (W, 2) in the middle of each."""
    side, margin = table.side, max(SHIFTS)
    cell = table.span_m / middle_m * camera.fx / side
    rows, columns = np.nonzero(mask)
    u, v = columns.mean(), rows.mean()
    weight = mask.astype(np.float32)
    background = ((~mask) & (depth > middle_m - 0.1 * table.diameter_m)).astype(np.float32)
    planes = np.dstack([lab * weight[..., None], (depth - np.float32(middle_m)) * weight, weight, background])
    wide = side + 2 * margin
    fine = max(1, min(4, round(cell)))  # samples a cell and axis, averaged: no aliasing
    step = cell / fine
    start = (wide * fine - 1) / 2.0 * step
    matrix = np.array([[step, 0.0, u - start], [0.0, step, v - start]])
    sampled = cv2.warpAffine(
        planes, matrix, (wide * fine, wide * fine), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    )
    canvas = np.asarray(cv2.resize(sampled, (wide, wide), interpolation=cv2.INTER_AREA), dtype=np.float32)
    covered = np.where(canvas[..., 4] > 0.3, canvas[..., 4], 0.0)
    canvas[..., :4] *= ((covered > 0) / np.maximum(canvas[..., 4], 1e-3))[..., None]
    canvas[..., 3] *= np.float32(MILLIMETRES)
    canvas[..., 4] = covered
    places = [(x, y) for y in SHIFTS for x in SHIFTS]
    windows = np.stack(
        [canvas[margin + y : margin + y + side, margin + x : margin + x + side] for x, y in places]
    )
    pixels = np.array([(u + x * cell, v + y * cell) for x, y in places])
    return windows.reshape(len(places), side * side, 6).astype(np.float32), pixels


def _best_window(table: TemplateTable, windows: Float32) -> tuple[np.ndarray, Float32]:
    """Index of the best window and its score, for each template."""
    count = len(windows)
    weight = windows[..., 4]
    values = [windows[..., c] for c in range(4)]
    columns = [weight, windows[..., 5]] + [weight * x for x in values] + [weight * x * x for x in values]
    by_coverage = table.coverage @ np.concatenate(columns).T
    crossed = [table.first[c] @ np.concatenate([weight, weight * values[c]]).T for c in range(4)]
    squared = [table.second[c] @ weight.T for c in range(4)]
    which = np.zeros(len(table.area), np.int64)
    scores = np.zeros(len(table.area), np.float32)
    _score_windows(
        by_coverage,
        crossed[0],
        crossed[1],
        crossed[2],
        crossed[3],
        squared[0],
        squared[1],
        squared[2],
        squared[3],
        table.area,
        np.maximum(weight.sum(1), 1.0).astype(np.float32),
        count,
        RELIEF * table.diameter_m * MILLIMETRES,
        which,
        scores,
    )
    return which, scores


@jit
def _score_windows(
    by_coverage: Float32,
    crossed_l: Float32,
    crossed_a: Float32,
    crossed_b: Float32,
    crossed_z: Float32,
    squared_l: Float32,
    squared_a: Float32,
    squared_b: Float32,
    squared_z: Float32,
    template_area: Float32,
    window_area: Float32,
    count: int,
    relief_mm: float,
    which: np.ndarray,
    scores: Float32,
) -> None:
    """Best of `count` windows for each template from the products' columns."""
    crossed = (crossed_l, crossed_a, crossed_b, crossed_z)
    squared = (squared_l, squared_a, squared_b, squared_z)
    for i in range(template_area.shape[0]):
        area = max(template_area[i], np.float32(1.0))
        best = -1e9
        for k in range(count):
            n = by_coverage[i, k]
            common = max(n, np.float32(1.0))
            color, color_weight, depth = 0.0, 2.0, 0.0
            for c in range(4):
                mean_w = by_coverage[i, (2 + c) * count + k] / common
                mean_t = crossed[c][i, k] / common
                var_w = max(by_coverage[i, (6 + c) * count + k] / common - mean_w * mean_w, 0.0)
                var_t = max(squared[c][i, k] / common - mean_t * mean_t, 0.0)
                covariance = crossed[c][i, count + k] / common - mean_w * mean_t
                if c < 3:
                    w = CHANNEL_WEIGHTS[c] * np.sqrt(var_t)
                    color += w * covariance / (np.sqrt(var_w * var_t) + CHANNEL_FLOOR)
                    color_weight += w
                else:
                    deviation = max(var_w + var_t - 2.0 * covariance, 0.0)
                    depth = np.exp(-deviation / (2.0 * relief_mm * relief_mm))
            total = (
                DEPTH_WEIGHT * depth
                + color / color_weight
                + OVERLAP_WEIGHT * n / window_area[k]
                - FREE_WEIGHT * by_coverage[i, count + k] / area
                + FULL_WEIGHT * n / area
            )
            if total > best:
                best = total
                which[i] = k
        scores[i] = best


def _onto_ray(ray: Float64) -> Float64:
    """The shortest rotation that takes the optical axis onto a ray (3,)."""
    axis = np.array([-ray[1], ray[0], 0.0])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return np.eye(3)
    angle = np.arctan2(sine, ray[2])
    x, y = axis[0] / sine, axis[1] / sine
    s, c = np.sin(angle), np.cos(angle)
    K = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + s * K + (1 - c) * (K @ K))
