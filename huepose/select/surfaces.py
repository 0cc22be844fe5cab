"""One surface, one pose: of poses that explain the same surface, the better one keeps it.

A surface is what a pose explains of a frame: the sorted numbers, without repeats, of its pieces, which are
pixels, cells of pixels or patches of depth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry.arrays import Bool, Int64

HALF = 0.5
"""A pose of whose surface others hold more than this has nothing of its own."""


def standing(surfaces: Sequence[Int64], scores: Sequence[float], share: float = HALF) -> list[int]:
    """Indices of the poses that stand, best score first, of equal ones the first: of the others, those that
    stand before them hold more than `share` of the surface.

    >>> standing([np.array([1, 2, 3]), np.array([2, 3, 4]), np.array([3, 4, 5])], [0.5, 0.9, 0.4])
    [1]
    >>> standing([np.array([1, 2]), np.array([2, 3])], [0.5, 0.9])
    [1, 0]
    """
    held = np.zeros(max((int(s.max(initial=-1)) for s in surfaces), default=-1) + 1, bool)
    out = []
    for i in sorted(range(len(surfaces)), key=lambda i: (-scores[i], i)):
        surface = surfaces[i]
        if np.count_nonzero(held[surface]) <= share * len(surface):
            out.append(i)
            held[surface] = True
    return out


def share_held(surface: Int64, held: Int64) -> float:
    """Share of a surface that is held, 0..1; nothing of an empty one is."""
    if not len(surface):
        return 0.0
    return len(np.intersect1d(surface, held, assume_unique=True)) / len(surface)


def pixels(mask: Bool | None) -> Int64:
    """The surface that a mask (H, W) shows; empty without one."""
    return np.zeros(0, np.int64) if mask is None else np.flatnonzero(mask)
