"""Build the surfels of a model, about two thousand evenly spaced samples of its visible surface, and a
lookup grid.

Sample elimination (Yuksel 2015, "Sample Elimination for Generating Poisson Disk Sample Sets") spaces them
evenly. It continues below the wanted number, which gives an order in which every prefix is evenly spaced,
too. A grid around the object stores the nearest surfel of each cell, so that finding a correspondence is
one lookup.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Int32, Int64
from huepose.model.types import COLOR_SCALES_M, DistanceGrid, Surface
from huepose.onboarding.cloud import Cloud, averaged_lab, smoothed_normals
from huepose.onboarding.visibility import DepthViews, seen
from huepose.support.jit import jit

COUNT = 2000  # surfels of a model
NORMAL_RADIUS_M = 0.003  # within which normals are averaged
_CANDIDATES = 8  # random samples for each surfel
MARGIN_M = 0.03  # of the grid around the object
_SMALLEST_STEP_M = 0.0015  # of the grid
_STEPS_PER_DIAMETER = 70.0  # of the grid of a large object


def build_surface(cloud: Cloud, views: DepthViews) -> Surface:
    """Surfels of a cloud, and which of them are visible from each view."""
    candidates = min(len(cloud.points), _CANDIDATES * COUNT)
    points, normals = cloud.points[:candidates], cloud.normals[:candidates]
    chosen = even_order(points, normals, cloud.area_m2, min(COUNT, candidates))
    points = points[chosen]
    normals = smoothed_normals(cloud, points, normals[chosen], NORMAL_RADIUS_M)
    lab = np.stack([averaged_lab(cloud, points, normals, sigma) for sigma in COLOR_SCALES_M])
    mask = seen(views, points, normals)
    return Surface(
        points=points.astype(np.float32),
        normals=normals.astype(np.float32),
        lab=lab,
        directions=views.directions.astype(np.float32),
        visible=np.nonzero(mask)[1].astype(np.int32),
        offsets=np.concatenate([[0], np.cumsum(mask.sum(1))]).astype(np.int32),
    )


def even_order(points: Float, normals: Float, area_m2: float, count: int) -> Int64:
    """Indices (count,) of evenly spaced points, ordered so that every prefix is evenly spaced too.

    points, normals (M, 3), random and dense on a surface of `area_m2`. Points on opposite sides of a thin
    wall do not count as neighbours.
    """
    alive = np.arange(len(points))
    tail: list[Int64] = []
    target = count
    while True:
        removed = _eliminated(points[alive], normals[alive], area_m2, target)
        if target < count:
            tail.append(alive[removed[::-1]])
        alive = np.delete(alive, removed)
        if target <= 4:
            break
        target //= 2
    return np.concatenate([alive, *tail[::-1]]).astype(np.int64)


def _eliminated(points: Float, normals: Float, area_m2: float, target: int) -> Int64:
    """Indices of the eliminated points, in order of elimination, until `target` are left."""
    from scipy.spatial import cKDTree

    count = len(points)
    if target >= count:
        return np.empty(0, np.int64)
    radius = np.sqrt(area_m2 / (2 * np.sqrt(3) * target))
    pairs = cKDTree(points).query_pairs(2 * radius, output_type="ndarray")
    same_side = np.einsum("nd,nd->n", normals[pairs[:, 0]], normals[pairs[:, 1]]) > -0.3
    pairs = pairs[same_side]
    distance = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    # The floor prevents clumps of the random input from dominating (section 3 of the paper).
    floor = radius * (1 - (target / count) ** 1.5) * 0.65
    weight = (1 - np.maximum(distance, 2 * floor) / (2 * radius)) ** 8
    ends = np.concatenate([pairs[:, 0], pairs[:, 1]])
    order = np.argsort(ends, kind="stable")
    neighbours = np.concatenate([pairs[:, 1], pairs[:, 0]])[order].astype(np.int32)
    offsets = np.searchsorted(ends[order], np.arange(count + 1)).astype(np.int32)
    return _eliminate(neighbours, offsets, np.concatenate([weight, weight])[order], count - target)


@jit
def _eliminate(neighbours: Int32, offsets: Int32, weights: Float, removals: int) -> Int64:
    count = offsets.shape[0] - 1
    total = np.zeros(count)
    for i in range(count):
        for k in range(offsets[i], offsets[i + 1]):
            total[i] += weights[k]
    out = np.empty(removals, np.int64)
    for step in range(removals):
        worst = 0
        most = -1.0
        for i in range(count):
            if total[i] > most:
                most = total[i]
                worst = i
        out[step] = worst
        total[worst] = -2.0
        for k in range(offsets[worst], offsets[worst + 1]):
            j = neighbours[k]
            if total[j] > -1.0:
                total[j] = max(total[j] - weights[k], 0.0)
    return out


def build_grid(points: Float, diameter_m: float) -> DistanceGrid:
    """Lookup grid of surfel `points` (N, 3), N < 32768, with a margin of 3 cm."""
    from scipy.spatial import cKDTree

    step = max(diameter_m / _STEPS_PER_DIAMETER, _SMALLEST_STEP_M)
    low = points.min(0).astype(np.float64) - MARGIN_M
    shape = np.ceil((points.max(0).astype(np.float64) + MARGIN_M - low) / step).astype(int) + 1
    axes = [low[k] + step * np.arange(shape[k]) for k in range(3)]
    tree = cKDTree(points)
    nearest = np.empty(shape, np.int16)
    for i, x in enumerate(axes[0]):  # one slice at a time needs half a gigabyte less
        y, z = np.meshgrid(axes[1], axes[2], indexing="ij")
        nearest[i] = tree.query(np.stack([np.full_like(y, x), y, z], -1))[1]
    return DistanceGrid(low, float(step), nearest)
