"""A textured triangle mesh in metres, in its own frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int32, UInt8


@dataclass(frozen=True, eq=False)
class Mesh:
    """vertices (V, 3) float32 metres; faces (F, 3) int32; uv (F, 3, 2) float32 per face corner in texture
    coordinates (u right, v *down*, 0..1 over the whole image: u * W - 0.5 is a column); texture (H, W, 3)
    uint8 RGB. If a file has colours per vertex, its reader makes a texture of them. digest: of the mesh's
    file, the key of cached data that are derived from the mesh, or None."""

    vertices: Float32
    faces: Int32
    uv: Float32
    texture: UInt8
    digest: str | None = None

    @cached_property
    def bounds(self) -> Float64:
        """Least and greatest coordinates (2, 3). Do not write to this array: all callers share it."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)]).astype(np.float64)

    @cached_property
    def centre(self) -> Float64:
        """Centre of the bounding box (3,). Do not write to this array: all callers share it."""
        return np.asarray((self.vertices.min(0) + self.vertices.max(0)) / 2.0, dtype=np.float64)

    def content(self) -> bytes:
        """All data that rendering uses, as bytes for a digest."""
        return b"".join(array.tobytes() for array in (self.vertices, self.faces, self.uv, self.texture))

    def face_normals(self) -> tuple[Float64, Float64]:
        """Unit normals (F, 3) by the right-hand rule, and areas (F,) in square metres."""
        v = self.vertices.astype(np.float64)
        n = np.cross(v[self.faces[:, 1]] - v[self.faces[:, 0]], v[self.faces[:, 2]] - v[self.faces[:, 0]])
        length = np.linalg.norm(n, axis=1)
        return n / np.maximum(length, 1e-18)[:, None], length / 2.0
