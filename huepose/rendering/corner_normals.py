"""Smooth normals per face corner: averaged over the faces that meet there, but not across creases."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int64
from huepose.geometry.mesh import Mesh
from huepose.support.jit import jit

CREASE_COS = float(np.cos(np.radians(40.0)))  # faces that bend more than this keep a sharp edge


def corner_normals(mesh: Mesh) -> Float32:
    """Unit normals (F, 3, 3) float32 at the corners of the faces, in the mesh frame.

    Corners at the same place count as one vertex, whatever their uv; each takes the mean of those faces there
    that bend less than 40 degrees from its own, weighted by the angle of the face at that corner, so that it
    does not matter how flat parts are cut into triangles (Thuermer and Wuethrich 1998).
    """
    normals, _ = mesh.face_normals()
    angles = _corner_angles(mesh)
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corner_place = place.reshape(-1)[mesh.faces.reshape(-1)]
    order = np.argsort(corner_place, kind="stable")
    starts = np.searchsorted(corner_place[order], np.arange(corner_place.max(initial=-1) + 2))
    return _smooth(normals, angles, corner_place, order, starts, CREASE_COS)


def _corner_angles(mesh: Mesh) -> Float64:
    """Angles (3 F,) in radians at the corners of the faces."""
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    ahead = np.roll(corners, -1, axis=1) - corners
    ahead /= np.maximum(np.linalg.norm(ahead, axis=2, keepdims=True), 1e-18)
    back = -np.roll(ahead, 1, axis=1)
    return np.asarray(np.arccos(np.clip((ahead * back).sum(2), -1.0, 1.0)).reshape(-1), np.float64)


@jit
def _smooth(
    normals: Float64, weights: Float64, places: Int64, corners_at: Int64, starts: Int64, crease_cos: float
) -> Float32:
    out = np.empty((normals.shape[0], 3, 3), np.float32)
    for f in range(normals.shape[0]):
        for c in range(3):
            place = places[3 * f + c]
            x, y, z = 0.0, 0.0, 0.0
            for k in range(starts[place], starts[place + 1]):
                corner = corners_at[k]
                g = corner // 3
                cos = (
                    normals[f, 0] * normals[g, 0]
                    + normals[f, 1] * normals[g, 1]
                    + normals[f, 2] * normals[g, 2]
                )
                if cos > crease_cos or g == f:
                    x += weights[corner] * normals[g, 0]
                    y += weights[corner] * normals[g, 1]
                    z += weights[corner] * normals[g, 2]
            length = max(np.sqrt(x * x + y * y + z * z), 1e-30)
            out[f, c, 0], out[f, c, 1], out[f, c, 2] = x / length, y / length, z / length
    return out
