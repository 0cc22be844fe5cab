"""Mesh simplification: hundreds of thousands of triangles would slow down rendering and tracking."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int32, Int64
from huepose.geometry.bilinear import bilinear
from huepose.geometry.mesh import Mesh
from huepose.onboarding.patches import fitting_patches
from huepose.onboarding.winding import welded

MAX_TRIANGLES = 60_000  # most triangles of a mesh that is kept as it is
TARGET = 20_000  # most triangles after simplification
_MAX_DISTANCE = 0.01  # between the simplified and the original surface, over the size of the mesh


def simplified(mesh: Mesh) -> Mesh:
    """The mesh itself if it has up to 60,000 triangles, otherwise a mesh of at most 20,000 with a new
    texture (needs Open3D).

    Vertex clustering (Rossignac and Borrel 1993): vertices with similar normals in one small cell are
    merged. Normals are compared so that the two sides of thin walls and of sharp edges stay separate. Cells
    grow until few enough triangles are left.
    """
    if len(mesh.faces) <= MAX_TRIANGLES:
        return mesh
    original = _Original(mesh)
    stay, numbers = welded(mesh.vertices)
    vertices, faces = mesh.vertices[stay].astype(np.float64), numbers[mesh.faces]
    normals = _vertex_normals(vertices, faces)
    size = float(np.ptp(vertices, axis=0).max())
    low, high = size / 2000, size / 10
    for _ in range(12):
        cell = float(np.sqrt(low * high))
        few = len(_clustered(vertices, faces, normals, cell)[1]) <= TARGET
        low, high = (low, cell) if few else (cell, high)
    lean_vertices, lean_faces = _clustered(vertices, faces, normals, high)
    if not len(lean_faces):
        return mesh
    layout = fitting_patches(lean_vertices, lean_faces)
    lean = Mesh(lean_vertices, lean_faces, layout.uv, mesh.texture)
    facing = lean.face_normals()[0]
    corners = lean_vertices.astype(np.float64)[lean_faces]
    texture = layout.baked(
        lambda chosen, w: original.colors(np.einsum("fk,fkd->fd", w, corners[chosen]), facing[chosen])
    )
    return Mesh(lean_vertices, lean_faces, layout.uv, texture)


def _vertex_normals(vertices: Float64, faces: Int64) -> Float64:
    corners = vertices[faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(total, faces[:, k], weighted)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30))


def _clustered(vertices: Float64, faces: Int64, normals: Float64, cell: float) -> tuple[Float32, Int32]:
    """Vertices (N, 3) and faces (F, 3) after the vertices of each cell and class of normals are merged into
    their mean."""
    place = np.floor((vertices - vertices.min(0)) / cell).astype(np.int64)
    facing = (
        np.round(normals * 1.2).astype(np.int64) + 1
    )  # 27 classes: along an axis, between two, between three
    key = ((place[:, 0] * 4096 + place[:, 1]) * 4096 + place[:, 2]) * 27
    key += (facing[:, 0] * 3 + facing[:, 1]) * 3 + facing[:, 2]
    _, cluster, count = np.unique(key, return_inverse=True, return_counts=True)
    cluster = cluster.reshape(-1)
    mean = np.stack([np.bincount(cluster, vertices[:, k]) for k in range(3)], 1) / count[:, None]
    f = cluster[faces]
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    first = np.argmin(f, axis=1)
    rolled = np.stack([np.take_along_axis(f, ((first + k) % 3)[:, None], 1)[:, 0] for k in range(3)], 1)
    f = np.unique(rolled, axis=0)
    used, index = np.unique(f, return_inverse=True)
    return mean[used].astype(np.float32), index.reshape(-1, 3).astype(np.int32)


class _Original:
    """Colours of the full mesh at points near its surface."""

    def __init__(self, mesh: Mesh) -> None:
        import open3d as o3d

        self._mesh = mesh
        self._reach = _MAX_DISTANCE * float(np.ptp(mesh.vertices, axis=0).max())
        self._normals = mesh.face_normals()[0]
        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(self._tensor(mesh.vertices), self._tensor(mesh.faces.astype(np.uint32)))

    def colors(self, points: Float64, normals: Float64) -> Float64:
        """Colours (N, 3) 0..255 of the original surface where rays along the normals (N, 3) through points
        (N, 3) hit it, otherwise of its nearest point. So each side of a thin wall keeps its own colours."""
        starts = points + self._reach * normals
        rays = np.concatenate([starts, -normals], 1).astype(np.float32)
        hit = self._scene.cast_rays(self._tensor(rays))
        face = hit["primitive_ids"].numpy().astype(np.int64)
        weights = hit["primitive_uvs"].numpy().astype(np.float64)
        met: Bool = hit["t_hit"].numpy() < 2 * self._reach
        met[met] = np.einsum("nd,nd->n", self._normals[face[met]], normals[met]) > 0
        if not met.all():
            left = self._tensor(points[~met].astype(np.float32))
            near = self._scene.compute_closest_points(left)
            face[~met] = near["primitive_ids"].numpy()
            weights[~met] = near["primitive_uvs"].numpy()
        b, c = weights[:, 0], weights[:, 1]
        uv = np.einsum("nk,nkd->nd", np.stack([1 - b - c, b, c], 1), self._mesh.uv[face].astype(np.float64))
        height, width = self._mesh.texture.shape[:2]
        return bilinear(self._mesh.texture, uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5)
