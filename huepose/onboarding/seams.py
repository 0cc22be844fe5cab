"""Finds textures that are upside down. Formats differ in the direction of v, and exporters confuse them.

At a seam, neighbouring triangles take their colours from different places of the texture. The colours on
both sides match only if the texture is the right way up.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int32, Int64
from huepose.onboarding.raw_mesh import RawMesh

ALONG = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
"""Positions on an edge where colours are compared: not at its ends, at which several triangles meet."""

WELDED, APART = 1e-5, 1e-3
"""Vertices within WELDED, over the largest side of the mesh, count as one; at a seam, texture coordinates
differ by more than APART."""

MOST = 20_000
"""Most seam edges that are compared, evenly chosen, to limit the time."""

CLEAR, TIMES = 8.0, 3.0
"""A texture is upside down if the colours at seams differ by more than CLEAR, in grey levels of 255, and by
more than TIMES the difference after the texture is flipped. After the flip, colours of different seams must
differ as much, too: in an empty part of the texture they do not. The 20 scanned meshes of YCB-Video: 0.6 to
7.4 as they are; flipped 8.7 and more (except for a marker), which is 4.6 to 95 times as much."""

UPSIDE_DOWN = (
    "its texture seems to be upside down: colours match along its seams only if it is flipped. Export the "
    "mesh again with the other direction of v, or flip the texture vertically"
)


def upside_down(mesh: RawMesh) -> bool:
    """Whether colours match along the seams of a mesh only if its textures are flipped vertically."""
    if mesh.uv is None or all(material.texture is None for material in mesh.materials):
        return False
    uv = mesh.uv
    one, other, lengths = _seams(mesh, uv)
    if not lengths.sum() > 0.0:
        return False
    here, there = _colors(mesh, uv, one), _colors(mesh, uv, other)
    here_flipped, there_flipped = _colors(mesh, uv, one, True), _colors(mesh, uv, other, True)

    def unlike(these: Float32, those: Float32) -> float:
        """Mean difference of colours."""
        return float(np.average(np.abs(these - those).mean((1, 2)), weights=lengths))

    of_others = np.random.default_rng(0).permutation(len(lengths))
    as_is, empty = unlike(here, there), unlike(here_flipped, there_flipped[of_others])
    return min(as_is, empty) > max(CLEAR, TIMES * unlike(here_flipped, there_flipped))


def _seams(mesh: RawMesh, uv: Float32) -> tuple[Int64, Int64, Float64]:
    """Edges at which two triangles meet with different texture coordinates: the edge (E, 2) of each triangle,
    as indices of flattened `faces` in the same direction, and lengths (E,)."""
    side, low = float(np.ptp(mesh.vertices, axis=0).max()), mesh.vertices.min(0)
    x, y, z = np.round((mesh.vertices - low) / (WELDED * side)).astype(np.int64).T
    cells = round(1.0 / WELDED) + 1  # along each axis; one number per cell, because sorting rows is slow
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


def _colors(mesh: RawMesh, uv: Float32, edges: Int64, flipped: bool = False) -> Float32:
    """Colours (E, A, 3) of the textures at the positions ALONG edges (E, 2) of a mesh; black without a
    texture."""
    ends = uv.reshape(-1, 2)[edges]
    at = ends[:, None, 0] * (1.0 - ALONG[:, None]) + ends[:, None, 1] * ALONG[:, None]
    u, v = at[..., 0], 1.0 - at[..., 1] if flipped else at[..., 1]
    out = np.zeros((*u.shape, 3), np.float32)
    materials: Int32 = mesh.face_materials[edges[:, 0] // 3]
    for k, material in enumerate(mesh.materials):
        if material.texture is None:
            continue
        mine, (height, width) = materials == k, material.texture.shape[:2]
        rows, columns = np.floor(v[mine] * height).astype(int), np.floor(u[mine] * width).astype(int)
        out[mine] = material.texture[rows % height, columns % width]
    return out
