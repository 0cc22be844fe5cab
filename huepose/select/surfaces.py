"""Suppression over surfaces: of poses that explain the same part of a frame, only the best stays.

A surface is what a pose explains of a frame: sorted unique ids of pixels, cells of pixels or patches of
depth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry.arrays import Bool, Int64

HALF = 0.5
"""A pose is suppressed when better poses hold more than this share of its surface."""


def standing(surfaces: Sequence[Int64], scores: Sequence[float], share: float = HALF) -> list[int]:
    """Greedy suppression: indices of the poses that stay, best score first (ties: the first). A pose goes if
    those that stay before it hold more than `share` of its surface.

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
    """Share of a surface that is held by others, 0..1; 0 for an empty surface."""
    if not len(surface):
        return 0.0
    return len(np.intersect1d(surface, held, assume_unique=True)) / len(surface)


def pixels(mask: Bool | None) -> Int64:
    """The surface of a mask (H, W) bool: ids of its pixels; empty without a mask."""
    return np.zeros(0, np.int64) if mask is None else np.flatnonzero(mask)
