"""Is a texture upside down? Formats disagree on whether v runs up or down, and exporters mix them up.

Along a seam, where neighbouring triangles take their colours from different places of the texture, colours
meet if the texture is the right way round.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int32, Int64
from huepose.onboarding.raw_mesh import RawMesh

ALONG = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
"""Where on an edge colours are compared: away from its ends, at which several triangles meet."""

WELDED, APART = 1e-5, 1e-3
"""Vertices so near, in largest sides of the mesh, are one; at a seam texture coordinates differ by more."""

MOST = 20_000
"""Seams that are looked at, evenly taken, with time in mind."""

CLEAR, TIMES = 8.0, 3.0
"""A texture is upside down where colours along seams differ by more than this, in grey levels of 255, and by
so many times what they differ by if it is turned over; and where those of different seams then do as well,
which they do not in an empty part of the texture. Of the 20 scanned meshes of YCB-Video they differ by 0.6 to
7.4 as they are; turned over by 8.7 and more (but for a marker), 4.6 to 95 times as much."""

UPSIDE_DOWN = (
    "its texture seems to be upside down: colours meet along its seams only if it is turned over. Export the "
    "mesh again with the other direction of v, or mirror its picture, top to bottom"
)


def upside_down(mesh: RawMesh) -> bool:
    """Whether colours meet along the seams of a mesh only if its textures are turned over."""
    if mesh.uv is None or all(material.texture is None for material in mesh.materials):
        return False
    uv = mesh.uv
    one, other, lengths = _seams(mesh, uv)
    if not lengths.sum() > 0.0:
        return False
    here, there = _colors(mesh, uv, one), _colors(mesh, uv, other)
    here_turned, there_turned = _colors(mesh, uv, one, True), _colors(mesh, uv, other, True)

    def unlike(these: Float32, those: Float32) -> float:
        """How much colours differ, on average."""
        return float(np.average(np.abs(these - those).mean((1, 2)), weights=lengths))

    of_others = np.random.default_rng(0).permutation(len(lengths))
    as_is, empty = unlike(here, there), unlike(here_turned, there_turned[of_others])
    return min(as_is, empty) > max(CLEAR, TIMES * unlike(here_turned, there_turned))


def _seams(mesh: RawMesh, uv: Float32) -> tuple[Int64, Int64, Float64]:
    """Pairs of edges at which two triangles meet with different texture coordinates: the one and the other
    (E, 2) as corners of `faces`, flattened, in the same direction, and lengths (E,)."""
    side, low = float(np.ptp(mesh.vertices, axis=0).max()), mesh.vertices.min(0)
    x, y, z = np.round((mesh.vertices - low) / (WELDED * side)).astype(np.int64).T
    cells = round(1.0 / WELDED) + 1  # along each axis; numbered, for rows of a table are sorted slowly
    welded: Int64 = np.unique((x * cells + y) * cells + z, return_inverse=True)[1].ravel()
    corners = np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    edges = np.concatenate([corners[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    ends = welded[mesh.faces.ravel()[edges]]
    edges = np.where((ends[:, 0] > ends[:, 1])[:, None], edges[:, ::-1], edges)
    keys = ends.min(1) * len(mesh.vertices) + ends.max(1)
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    one, other = edges[order[same]], edges[order[same + 1]]
    coordinates = uv.reshape(-1, 2)
    apart = np.flatnonzero(np.abs(coordinates[one] - coordinates[other]).max((1, 2)) > APART)
    one, other = (edges[apart[:: -(-len(apart) // MOST) or 1]] for edges in (one, other))
    places = mesh.vertices[mesh.faces.ravel()[one]]
    return one, other, np.linalg.norm(places[:, 0] - places[:, 1], axis=1)


def _colors(mesh: RawMesh, uv: Float32, edges: Int64, turned_over: bool = False) -> Float32:
    """Colours (E, A, 3) ALONG edges (E, 2) of a mesh, in the texture of each; black without one."""
    ends = uv.reshape(-1, 2)[edges]
    at = ends[:, None, 0] * (1.0 - ALONG[:, None]) + ends[:, None, 1] * ALONG[:, None]
    u, v = at[..., 0], 1.0 - at[..., 1] if turned_over else at[..., 1]
    out = np.zeros((*u.shape, 3), np.float32)
    materials: Int32 = mesh.face_materials[edges[:, 0] // 3]
    for k, material in enumerate(mesh.materials):
        if material.texture is None:
            continue
        mine, (height, width) = materials == k, material.texture.shape[:2]
        rows, columns = np.floor(v[mine] * height).astype(int), np.floor(u[mine] * width).astype(int)
        out[mine] = material.texture[rows % height, columns % width]
    return out
