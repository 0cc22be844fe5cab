"""Smooth normals per face corner: averaged over the faces that meet there, but not across creases."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int64
from huepose.geometry.mesh import Mesh
from huepose.support.jit import jit

CREASE_COS = float(np.cos(np.radians(40.0)))  # faces that bend more than this keep a sharp edge


def corner_normals(mesh: Mesh) -> Float32:
    """Unit normals (F, 3, 3) float32 at the corners of the faces, in the mesh frame.

    Corners at the same place count as one vertex, whatever their uv; each takes the area-weighted mean of
    those faces there that bend less than 40 degrees from its own.
    """
    normals, areas = mesh.face_normals()
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corner_place = place.reshape(-1)[mesh.faces.reshape(-1)]
    order = np.argsort(corner_place, kind="stable")
    starts = np.searchsorted(corner_place[order], np.arange(corner_place.max(initial=-1) + 2))
    return _smooth(normals, areas, corner_place, order // 3, starts, CREASE_COS)


@jit
def _smooth(
    normals: Float64, areas: Float64, places: Int64, faces_at: Int64, starts: Int64, crease_cos: float
) -> Float32:
    out = np.empty((normals.shape[0], 3, 3), np.float32)
    for f in range(normals.shape[0]):
        for c in range(3):
            place = places[3 * f + c]
            x, y, z = 0.0, 0.0, 0.0
            for k in range(starts[place], starts[place + 1]):
                g = faces_at[k]
                cos = (
                    normals[f, 0] * normals[g, 0]
                    + normals[f, 1] * normals[g, 1]
                    + normals[f, 2] * normals[g, 2]
                )
                if cos > crease_cos or g == f:
                    x += areas[g] * normals[g, 0]
                    y += areas[g] * normals[g, 1]
                    z += areas[g] * normals[g, 2]
            length = max(np.sqrt(x * x + y * y + z * z), 1e-30)
            out[f, c, 0], out[f, c, 1], out[f, c, 2] = x / length, y / length, z / length
    return out
