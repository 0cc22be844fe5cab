"""How large a set of points is: its largest distance, in far less than all pairs, and its least thickness."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64

_BLOCK = 1000  # points that lie together, whose distances to those opposite are in memory at once
_SLACK = 1e-6  # of the distance: what rounding may cost a bound


def largest_distance(points: Float64) -> float:
    """The largest distance of any two of points (n, 3), in their unit; exactly that of all pairs.

    With c the middle of a pair at distance d and R the radius about c that holds all points, the
    parallelogram law puts who is d or more from p within sqrt(2 |p - c|^2 + 2 R^2 - d^2) of the mirror image
    of p in c; where that is no number, nobody is. Of a ball or a capsule that leaves few pairs.
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
    """A large distance of two points, and their middle: always on to the farthest, until it is no farther."""
    from scipy.spatial.distance import cdist

    best, here, middle = 0.0, points[0], points[0]
    while True:
        away = cdist(here[None], points)[0]
        there = points[away.argmax()]
        if away.max() <= best:
            return best, middle
        best, here, middle = float(away.max()), there, (here + there) / 2


def thickness(points: Float64) -> float:
    """The least distance of two parallel planes that hold all of points (n, 3) between them: one of them lies
    on a side of their convex hull."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        return 0.0
    return float(np.ptp(points[hull.vertices] @ hull.equations[:, :3].T, axis=0).min())
