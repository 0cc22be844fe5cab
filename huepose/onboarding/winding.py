"""Orientation of a mesh's faces: which side is outside."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float64, Int, Int64

_FLAT = 1e-6
"""A part with less volume than this, over the power 3/2 of its area, is a sheet: it has no outside."""

_TILT = se3.rotation_exp(np.array([0.3, 0.5, 0.7]))
"""Rotation in which rays along z do not meet the edges of meshes that are aligned with their axes."""


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


def facing_inwards(vertices: Float, faces: Int) -> Bool:
    """Which faces (F,) of a closed mesh have their right-hand normals inwards (a mirrored export).

    Each connected part is judged by itself: in an assembly, single parts may be mirrored. A part that lies
    inside of others, such as the wall of a cavity, goes with them. None for a mesh that is not closed.
    """
    if outward_sign(vertices, faces) == 0:
        return np.zeros(len(faces), bool)
    v = np.asarray(vertices, np.float64)
    corners = (v - v.mean(0))[np.asarray(faces)] @ _TILT.T
    part, count = _parts(vertices, faces)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volumes = np.bincount(part, np.einsum("fi,fi->f", corners[:, 0], normals) / 6.0, count)
    areas = np.bincount(part, np.linalg.norm(normals, axis=1) / 2.0, count)
    inwards = volumes < -_FLAT * areas**1.5
    if inwards.any():
        order = np.argsort(part, kind="stable")
        corners, of = corners[order].transpose(1, 2, 0).copy(), part[order]
        begins = np.searchsorted(of, np.arange(count))
        own = np.split(corners, begins[1:], axis=2)
        low, high = corners.min(0), corners.max(0)
        lowest, highest = np.minimum.reduceat(low, begins, 1), np.maximum.reduceat(high, begins, 1)
        for k in range(count):
            least, most = lowest[:, k, None], highest[:, k, None]
            around = np.logical_and((lowest <= least).all(0), (highest >= most).all(0))
            around[k] = False
            if around.any():
                above = around[of] & (low[:2] <= most[:2]).all(0) & (high >= least).all(0)
                winding = _winding(own[k], corners[:, :, np.flatnonzero(above)])
                if winding != 0:
                    inwards[k] = winding < 0
    return np.asarray(inwards[part])


def _parts(vertices: Float, faces: Int) -> tuple[Int64, int]:
    """The connected part (F,) of each face, and their number. Vertices at the same position count as one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    stay, numbers = welded(vertices)
    f = numbers[faces]
    links = (np.ones(2 * len(f), bool), (np.repeat(f[:, 0], 2), f[:, 1:].reshape(-1)))
    _, of_vertex = connected_components(coo_matrix(links, shape=(len(stay),) * 2), directed=False)
    parts, part = np.unique(of_vertex[f[:, 0]], return_inverse=True)
    return part.reshape(-1).astype(np.int64), len(parts)


def _winding(own: Float64, others: Float64) -> int:
    """How often some faces (corner, axis, face) wind around a part with the faces `own`; 0 if one of its
    outermost points is outside of them. Of the faces above a point, those that look down count as
    negative."""
    points = own.transpose(0, 2, 1).reshape(-1, 3)
    counts = []
    for p in points[np.unique([points.argmin(0), points.argmax(0)])]:
        a, b, c = others - p[:, None]
        shares = np.stack([q[0] * r[1] - q[1] * r[0] for q, r in ((b, c), (c, a), (a, b))])
        side = np.where((shares > 0).all(0), 1, np.where((shares < 0).all(0), -1, 0))
        height = (shares * np.stack([a[2], b[2], c[2]])).sum(0) * side
        counts.append(int(side[height > 0].sum()))
    return min(counts, key=abs)
