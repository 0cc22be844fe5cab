"""Orientation of a mesh's faces: which side is outside."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Int, Int64


def welded(vertices: Float) -> tuple[Int64, Int64]:
    """Merge vertices (V, 3) at the same position, to a millionth of the size: indices (N,) of those that
    stay, and for each vertex (V,) the position of its representative in that list."""
    v = np.asarray(vertices, np.float64)
    places = np.round((v - v.mean(0)) / (np.ptp(v) * 1e-6 + 1e-30)).astype(np.int64)
    _, first, inverse = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return first.astype(np.int64), inverse.reshape(-1).astype(np.int64)


def outward_sign(vertices: Float, faces: Int) -> int:
    """1 if the right-hand normals of a closed mesh point outwards, -1 if inwards (a mirrored export), 0 if
    it is not closed or neighbouring faces disagree. Vertices at the same position count as one."""
    stay, numbers = welded(vertices)
    f = numbers[faces]
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    start, end = f.reshape(-1), f[:, [1, 2, 0]].reshape(-1)
    count = len(stay)
    if not np.array_equal(np.sort(start * count + end), np.sort(end * count + start)):
        return 0
    v = np.asarray(vertices, np.float64)
    corner = (v - v.mean(0))[np.asarray(faces)]
    volume = np.einsum("fi,fi->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))
    return 1 if volume > 0 else -1
