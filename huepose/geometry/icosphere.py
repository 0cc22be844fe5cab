"""Evenly spread viewing directions: the vertices of a subdivided icosahedron."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from huepose.geometry.arrays import Float, Float64, Int32


@lru_cache(maxsize=8)
def directions(level: int) -> Float64:
    """Unit vectors (V, 3), read-only, in a fixed order: 12, 42, 162, 642 for levels 0 to 3."""
    phi = (1 + 5**0.5) / 2
    corners = [(0.0, s, t * phi) for s in (1.0, -1.0) for t in (1.0, -1.0)]
    points = np.array([np.roll(c, k) for k in range(3) for c in corners])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    edge = distance[distance > 0].min() * 1.01
    faces = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if max(distance[i, j], distance[j, k], distance[i, k]) < edge
    ]
    vertices = [tuple(p) for p in points]
    for _ in range(level):
        middles: dict[tuple[int, int], int] = {}

        def middle(a: int, b: int, middles: dict[tuple[int, int], int] = middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                m = np.add(vertices[a], vertices[b])
                middles[key] = len(vertices)
                vertices.append(tuple(m / np.linalg.norm(m)))
            return middles[key]

        faces = [
            new
            for a, b, c in faces
            for ab, bc, ca in [(middle(a, b), middle(b, c), middle(c, a))]
            for new in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        ]
    out = np.array(vertices)
    out.setflags(write=False)
    return out


def neighbours(level: int) -> Int32:
    """Indices (V, 6) of the six nearest vertices of each vertex, with all that share an edge with it. From
    any vertex, steps to the neighbour nearest to a direction lead to the vertex nearest to it."""
    vertices = directions(level)
    return np.argsort(-(vertices @ vertices.T), axis=1, kind="stable")[:, 1:7].astype(np.int32)


def look_at(direction: Float) -> Float64:
    """Rotation R_cam_obj (3, 3) of a camera that is in `direction` (3,) from the object and looks at its
    origin. Up in the image is the object's z axis, or its x axis if the camera looks nearly along z."""
    d = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    up = np.array([0.0, 0.0, 1.0]) if abs(d[2]) < 0.95 else np.array([1.0, 0.0, 0.0])
    x = np.cross(-d, up)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(-d, x), -d])
