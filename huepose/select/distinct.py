"""Suppression: of poses close to each other, and of poses that explain the same part of a frame, only the
best stays.

While poses are still being refined, two are close if they differ little in rotation and translation
(`different_poses`). Of finished poses, two are one answer if both would count as the same right pose
(`different_answers`): their surfaces are within a tenth of the diameter of each other, up to the object's
symmetries. `Ranked` holds poses in their order, each with its total.

A surface is the part of a frame that a pose explains: sorted unique ids of pixels, cells of pixels or patches
of depth (`standing`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float, Float64, Int64
from huepose.geometry.suppression import first_different
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit


@dataclass(frozen=True, eq=False)
class Ranked:
    """Poses in order. poses: T_cam_obj (K, 4, 4), best first; totals (K,): of the judge; behind (K,):
    distance to the first by everything that orders them, in units of the total, 0 for the first, never
    negative."""

    poses: Float64
    totals: Float64
    behind: Float64

    @classmethod
    def of(cls, poses: Float64, totals: Float64, scores: Float64 | None = None) -> Ranked:
        """Rank poses (K, 4, 4) with totals (K,) by scores (K,), by default the totals."""
        scores = totals if scores is None else scores
        order = np.argsort(-scores, kind="stable")
        return cls(poses[order], totals[order], scores[order[:1]] - scores[order])

    def __len__(self) -> int:
        return len(self.poses)

    def these(self, indices: Sequence[int] | Int64) -> Ranked:
        """A selection of the poses, which must include the first."""
        kept = np.asarray(indices, dtype=np.int64)
        return Ranked(self.poses[kept], self.totals[kept], self.behind[kept])


NONE = Ranked(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0))
"""No pose was found."""


FINAL_TURN_RAD, FINAL_SHIFT = 0.2, 0.05
"""Rotation (radians) and translation (diameters) below which two refined poses are one."""

RIGHT = 0.1
"""Largest mean surface distance, in diameters, at which a pose counts as right (the usual ADD threshold), and
two poses as one answer."""

POINTS = 100
"""Points of the model, evenly taken, over which the distance of two poses is averaged."""


def different_poses(
    model: ReferenceModel,
    poses: Float64,
    totals: Float64,
    count: int,
    turn_rad: float = 0.15,
    shift: float = 0.03,
) -> np.ndarray:
    """Indices (K,) of at most `count` poses (N, 4, 4), best total first, that differ from all better ones by
    `turn_rad` or by `shift` diameters at the object's centre."""
    order = np.argsort(-totals, kind="stable")
    first = first_different(poses[order], turn_rad, count, shift * model.diameter_m, model.mesh.centre)
    return np.asarray(order[first])


def different_answers(model: ReferenceModel, poses: Float64) -> Int64:
    """Indices (K,) of those poses (N, 4, 4), best first, that differ from all better ones that are kept."""
    stride = max(1, len(model.eval_points) // POINTS)
    points = np.asarray(model.eval_points[::stride], dtype=np.float64)
    kept: list[int] = []
    alike = np.zeros((0, 4, 4))
    for k, T in enumerate(poses):
        if not _is_near(T, alike, points, RIGHT * model.diameter_m):
            kept.append(k)
            alike = np.concatenate([alike, T @ model.equivalents])
    return np.array(kept, dtype=np.int64)


@jit
def _is_near(T: Float64, others: Float64, points: Float64, near_m: float) -> bool:
    """Whether a pose (4, 4) moves points (N, 3) less than `near_m` away from another of (M, 4, 4), on
    average."""
    for m in range(others.shape[0]):
        apart, total = T - others[m], 0.0
        for k in range(points.shape[0]):
            square = 0.0
            for r in range(3):
                off = apart[r, 3]
                for c in range(3):
                    off += apart[r, c] * points[k, c]
                square += off * off
            total += np.sqrt(square)
        if total < near_m * points.shape[0]:
            return True
    return False


HALF = 0.5
"""A pose is suppressed when better poses hold more than this share of its surface."""


def standing(
    surfaces: Sequence[Int64],
    scores: Sequence[float],
    misfits: Sequence[Float] | None = None,
    margin: float = 0.0,
) -> list[int]:
    """Greedy suppression: indices of the poses that stay, best score first (ties: the first). A pose goes if
    those that stay before it hold more than HALF of its surface. misfits: how badly each piece of each
    surface fits the image; a pose that fits worse than another by more than the margin does not hold a piece.

    >>> standing([np.array([1, 2, 3]), np.array([2, 3, 4]), np.array([3, 4, 5])], [0.5, 0.9, 0.4])
    [1]
    >>> standing([np.array([1, 2]), np.array([2, 3])], [0.5, 0.9])
    [1, 0]
    >>> standing([np.array([1, 2]), np.array([1, 2])], [0.5, 0.9], [[0.0, 0.0], [2.0, 2.0]], 1.0)
    [1, 0]
    """
    held = np.full(max((int(s.max(initial=-1)) for s in surfaces), default=-1) + 1, np.inf)
    out = []
    for i in sorted(range(len(surfaces)), key=lambda i: (-scores[i], i)):
        surface = surfaces[i]
        own = np.zeros(len(surface)) if misfits is None else np.asarray(misfits[i])
        if np.count_nonzero(held[surface] <= own + margin) <= HALF * len(surface):
            out.append(i)
            held[surface] = np.minimum(held[surface], own)
    return out


def share_held(surface: Int64, held: Int64) -> float:
    """Share of a surface that other poses hold, 0..1; 0 for an empty surface."""
    if not len(surface):
        return 0.0
    return len(np.intersect1d(surface, held, assume_unique=True)) / len(surface)


def pixels(mask: Bool | None) -> Int64:
    """The surface of a mask (H, W) bool: ids of its pixels; empty without a mask."""
    return np.zeros(0, np.int64) if mask is None else np.flatnonzero(mask)
