"""Polygons to triangles: as a fan from the first corner, or by ear clipping if a fan leaves the polygon.

A fan is right if the whole polygon is visible from its first corner. For an L, a fan from a wrong corner
covers area outside of it: the model of a bracket would have its recess filled.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from huepose.geometry.arrays import Float, Float64, Int, Int32
from huepose.support.errors import InputError

LARGEST = 2000
"""Most corners of a polygon for ear clipping, which takes half a second for so many."""
_AGAINST = 1e-4
"""A fan leaves its polygon if one of its triangles faces the other way with more than this share of the
area."""


def left(vertices: Float, faces: Int, polygon: Int) -> list[slice]:
    """The triangles, as slices, of each polygon whose fan leaves it.

    vertices (V, 3); faces (F, 3) of all fans; polygon (F,): the polygon of each triangle, from 0,
    ascending."""
    if (np.diff(polygon) > 0).all():  # all polygons are triangles
        return []
    a, b, c = (np.asarray(vertices, np.float64)[faces[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)
    whole = np.stack([np.bincount(polygon, areas[:, k]) for k in range(3)], 1)
    against = (areas * whole[polygon]).sum(1) < -_AGAINST * (whole**2).sum(1)[polygon]
    numbers = np.unique(polygon[against])
    ends = zip(np.searchsorted(polygon, numbers), np.searchsorted(polygon, numbers, "right"), strict=True)
    return [slice(start, end) for start, end in ends]


def ears(points: Float, path: Path) -> Int32:
    """Triangles (N - 2, 3) of a polygon (N, 3) by ear clipping, as indices of its corners in its direction.

    A polygon may touch itself, like one with a hole that is cut open. Raises InputError, naming the mesh
    file, for more than `LARGEST` corners."""
    if len(points) > LARGEST:
        raise InputError(
            path,
            found=f"a polygon with a recess and {len(points)} corners",
            expected=f"at most {LARGEST}",
            fix="Export again with triangles.",
        )
    flat = _flat(np.asarray(points, np.float64))
    rest = list(range(len(flat)))
    triangles = []
    at = 0
    while len(rest) > 3:
        place = _next_ear(flat, rest, at)
        triangles.append((rest[place - 1], rest[place], rest[(place + 1) % len(rest)]))
        del rest[place]
        at = place % len(rest)
    return np.array([*triangles, tuple(rest)], np.int32)


def _flat(points: Float64) -> Float64:
    """The polygon (N, 2) projected along the axis that keeps most of its area, counter-clockwise."""
    centred = points - points[0]
    normal = np.cross(centred, np.roll(centred, -1, 0)).sum(0)
    drop = int(np.abs(normal).argmax())
    kept = [axis for axis in range(3) if axis != drop]
    flat: Float64 = centred[:, kept[::-1] if (normal[drop] < 0) != (drop == 1) else kept]
    return flat


def _next_ear(flat: Float64, rest: list[int], start: int) -> int:
    """Index in `rest` of an ear: a convex corner whose triangle contains no other corner. If there is none,
    the corner that is nearest to straight."""
    corners = flat[rest]
    before, after = corners - np.roll(corners, 1, 0), np.roll(corners, -1, 0) - corners
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    for step in range(len(rest)):
        place = (start + step) % len(rest)
        if turn[place] > 0 and not _holds_another(corners, place):
            return place
    return int(np.abs(turn).argmin())


def _holds_another(corners: Float64, place: int) -> bool:
    """Whether another corner lies in the triangle of a corner; those at the triangle's own corners do not
    count."""
    a, b, c = corners[place - 1], corners[place], corners[(place + 1) % len(corners)]
    inside = np.ones(len(corners), bool)
    for p, q in ((a, b), (b, c), (c, a)):
        along, to = q - p, corners - p
        inside &= along[0] * to[:, 1] - along[1] * to[:, 0] >= 0
    for p in (a, b, c):
        inside &= (corners != p).any(1)
    return bool(inside.any())
