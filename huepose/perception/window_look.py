"""Which views of an object look like what is in which windows? All pairs of both by matrix products."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int64
from huepose.geometry.camera import Camera
from huepose.perception.window_table import WindowTable, middle_hues
from huepose.perception.windows import Windows
from huepose.propose.quick_look import product
from huepose.propose.template_table import MILLIMETRES
from huepose.propose.views import onto_rays
from huepose.support.jit import jit

RELIEF = 0.05
"""Deviation of relief, in diameters, at which its term has fallen to 0.6."""

LIGHT = 16.0
"""Difference of mean hue, in units of opponents, that light alone may make."""

LIGHTNESS_WEIGHT = 0.35
FLOOR = 9.0
MIN_CELLS = 1.2
DEPTH_WEIGHT, TEXTURE_WEIGHT, HUE_WEIGHT = 0.8, 1.0, 0.8
RIM_WEIGHT, FREE_WEIGHT, FULL_WEIGHT = 0.6, 0.8, 0.8


@dataclass(frozen=True, eq=False)
class Looks:
    """Pairs of a window and a view, best first: poses T_cam_obj (K, 4, 4), scores (K,), windows (K,)."""

    poses: Float64
    scores: Float64
    windows: Int64


def promising(table: WindowTable, windows: Windows) -> Int64:
    """Indices (W,) of windows: first the pieces', then by how near the hue of their middle is to the
    object's."""
    weight = windows.cells[..., 4]
    weighted = np.stack([weight * windows.cells[..., 1], weight * windows.cells[..., 2]])
    hues = middle_hues(weight, weighted)
    apart = ((hues[:, None] - table.hues[None]) ** 2).sum(-1).min(1)
    apart[: windows.pieces] -= 1e6
    return np.argsort(apart, kind="stable")


def look(table: WindowTable, windows: Windows, camera: Camera, count: int, each: int) -> Looks:
    """The `count` best pairs of all, at most `each` of one window."""
    if not len(windows):
        return Looks(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, np.int64))
    scores, relief_mm = _compared(table, windows.cells)
    views = table.views
    each = min(each, scores.shape[0])
    best = np.argpartition(-scores, each - 1, axis=0)[:each]
    window = np.broadcast_to(np.arange(len(windows)), best.shape).ravel()
    view = best.ravel()
    rated = scores[view, window]
    order = np.argsort(-rated, kind="stable")[:count]
    view, window = view[order], window[order]
    depth_m = windows.depth_m[window] + relief_mm[view, window] / MILLIMETRES
    rays = camera.rays(windows.pixels[window])
    turns = onto_rays(rays)
    poses = np.tile(np.eye(4), (len(order), 1, 1))
    poses[:, :3, :3] = turns @ views.rotations[view]
    poses[:, :3, 3] = rays * depth_m[:, None] + np.einsum("nij,nj->ni", turns, views.origins[view])
    return Looks(poses, rated[order].astype(np.float64), window)


def _compared(rimmed: WindowTable, cells: Float32) -> tuple[Float32, Float32]:
    """Scores (N, W) of all views in all windows, and relief (N, W) of the view's middle in the window."""
    table, count = rimmed.views, len(cells)
    going_on = product(rimmed.rim, cells[..., 4].T)
    cells = cells[:, table.used]
    weight = cells[..., 4]
    values = [cells[..., c] for c in range(4)]
    columns = [weight, cells[..., 5]] + [weight * x for x in values] + [weight * x * x for x in values]
    by_coverage = product(table.coverage, np.concatenate(columns).T)
    crossed = np.stack(
        [product(table.first[c], np.concatenate([weight, weight * values[c]]).T) for c in range(4)]
    )
    squared = np.stack([product(table.second[c], weight.T) for c in range(4)])
    scores = np.empty((len(table.area), count), np.float32)
    relief = np.empty_like(scores)
    relief_mm = RELIEF * table.diameter_m * MILLIMETRES
    _rate(by_coverage, crossed, squared, going_on, table.area, relief_mm, scores, relief)
    return scores, relief


@jit
def _rate(
    by_coverage: Float32,
    crossed: Float32,
    squared: Float32,
    going_on: Float32,
    template_area: Float32,
    relief_mm: float,
    scores: Float32,
    relief: Float32,
) -> None:
    count = going_on.shape[1]
    for i in range(template_area.shape[0]):
        area = max(template_area[i], np.float32(1.0))
        for k in range(count):
            n = by_coverage[i, k]
            if n < MIN_CELLS or n < 0.15 * area:
                scores[i, k] = -9.0
                relief[i, k] = 0.0
                continue
            color, color_weight, hue, depth = 0.0, 2.0, 0.0, 0.0
            for c in range(4):
                mean_w = by_coverage[i, (2 + c) * count + k] / n
                mean_t = crossed[c, i, k] / n
                var_w = max(by_coverage[i, (6 + c) * count + k] / n - mean_w * mean_w, 0.0)
                var_t = max(squared[c, i, k] / n - mean_t * mean_t, 0.0)
                covariance = crossed[c, i, count + k] / n - mean_w * mean_t
                if c < 3:
                    w = np.sqrt(var_t) * (LIGHTNESS_WEIGHT if c == 0 else 1.0)
                    color += w * covariance / (np.sqrt(var_w * var_t) + FLOOR)
                    color_weight += w
                    if c > 0:
                        hue += (mean_w - mean_t) ** 2
                else:
                    deviation = max(var_w + var_t - 2.0 * covariance, 0.0)
                    depth = np.exp(-deviation / (2.0 * relief_mm * relief_mm))
                    relief[i, k] = mean_w - mean_t
            scores[i, k] = (
                DEPTH_WEIGHT * depth
                + TEXTURE_WEIGHT * color / color_weight
                + HUE_WEIGHT * np.exp(-hue / (2.0 * LIGHT * LIGHT))
                - RIM_WEIGHT * going_on[i, k]
                - FREE_WEIGHT * by_coverage[i, count + k] / area
                + FULL_WEIGHT * n / area
            )
