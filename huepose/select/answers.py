"""Which of the poses that were found are different answers, and not the same answer twice?

Poses are told apart by what counts as right: two that lie within a tenth of the diameter of each other, up to
the rotations under which shape and texture look the same, are one answer, of which the better one is kept.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64, Int64
from huepose.model.types import ReferenceModel

ONE_ANSWER = 0.1
"""Mean distance of the surface's points, in diameters, up to which two poses are one answer."""

POINTS = 100


def different_answers(model: ReferenceModel, poses: Float64) -> Int64:
    """Indices (K,) of those poses (N, 4, 4), best first, that differ from all better ones that are kept."""
    points = _points(model)
    placed = [_placed(points, T) for T in poses]
    kept: list[int] = []
    alike: list[list[Float64]] = []
    for k, here in enumerate(placed):
        near = ONE_ANSWER * model.diameter_m
        if any(_distance(here, other) < near for group in alike for other in group):
            continue
        kept.append(k)
        alike.append([here, *(_placed(points, poses[k] @ turn) for turn in model.equivalents[1:])])
    return np.array(kept, dtype=np.int64)


def _points(model: ReferenceModel) -> Float64:
    """At most POINTS of the model's points (N, 3), evenly taken."""
    stride = max(1, len(model.eval_points) // POINTS)
    return np.asarray(model.eval_points[::stride], dtype=np.float64)


def _placed(points: Float64, T: Float64) -> Float64:
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def _distance(one: Float64, other: Float64) -> float:
    return float(np.linalg.norm(one - other, axis=1).mean())
