"""Which side of a mesh's faces is out."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Int


def outward_sign(vertices: Float, faces: Int) -> int:
    """1 where the right-hand normals of a closed mesh point outwards, -1 where inwards (a mirrored export), 0
    where it is not closed or neighbouring faces disagree. Vertices at one place count as one."""
    v = np.asarray(vertices, np.float64)
    v = v - v.mean(0)
    places = np.round(v / (np.ptp(v) * 1e-6 + 1e-30)).astype(np.int64)
    welded = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)
    f = welded[faces].astype(np.int64)
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    start, end = f.reshape(-1), f[:, [1, 2, 0]].reshape(-1)
    count = int(welded.max()) + 1
    if not np.array_equal(np.sort(start * count + end), np.sort(end * count + start)):
        return 0
    corner = v[np.asarray(faces)]
    volume = np.einsum("fi,fi->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))
    return 1 if volume > 0 else -1
