"""Size of a set of points: the largest distance, without comparing all pairs, and the least thickness."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64

_BLOCK = 1000  # neighbouring points whose distances to the points opposite are computed at once
_SLACK = 1e-6  # share of the distance by which bounds are widened against rounding


def largest_distance(points: Float64) -> float:
    """The exact largest distance between any two of points (n, 3), in their unit.

    Let c be the middle of a pair at distance d, and R the radius about c that contains all points. By the
    parallelogram law, all points at a distance of d or more from p are within
    sqrt(2 |p - c|^2 + 2 R^2 - d^2) of the mirror image of p in c; if the root is not real, there are none.
    For a ball or a capsule few pairs remain.
    """
    from scipy.spatial import cKDTree
    from scipy.spatial.distance import cdist

    best, centre = _far_pair(points)
    squared = ((points - centre) ** 2).sum(1)
    rest = 2 * (squared + squared.max()) - best**2
    kept = rest >= -_SLACK * best**2
    points, reach = points[kept], np.sqrt(rest[kept].clip(0.0)) + _SLACK * best
    order = cKDTree(points, leafsize=_BLOCK).indices
    points, reach = points[order], reach[order]
    for start in range(0, len(points), _BLOCK):
        block = points[start : start + _BLOCK]
        middle = block.mean(0)
        radius = np.linalg.norm(block - middle, axis=1).max() + reach[start : start + _BLOCK].max()
        opposite = points[((points - (2 * centre - middle)) ** 2).sum(1) <= radius**2]
        if len(opposite):
            best = max(best, float(cdist(block, opposite).max()))
    return best


def _far_pair(points: Float64) -> tuple[float, Float64]:
    """A large distance between two points, and their middle: goes on to the farthest point until the
    distance no longer grows."""
    from scipy.spatial.distance import cdist

    best, here, middle = 0.0, points[0], points[0]
    while True:
        away = cdist(here[None], points)[0]
        there = points[away.argmax()]
        if away.max() <= best:
            return best, middle
        best, here, middle = float(away.max()), there, (here + there) / 2


def thickness(points: Float64) -> float:
    """The least distance between two parallel planes with all points (n, 3) between them, one of which
    contains a face of the convex hull; 0 for points without a hull."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        return 0.0
    return float(np.ptp(points[hull.vertices] @ hull.equations[:, :3].T, axis=0).min())
