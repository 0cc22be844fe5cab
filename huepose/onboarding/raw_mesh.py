"""The mesh as read from a file, before unit and texture are decided: the common output of the readers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64, Int, Int32, UInt8
from huepose.support.errors import InputError

RE_EXPORT = "Export the mesh again as OBJ, PLY or GLB with its texture."
SIMPLIFY = "Simplify the mesh (Blender: Decimate; MeshLab: Quadric Edge Collapse Decimation)"
LARGEST_FACES = 5_000_000
"""Most triangles of a mesh: a scan of a hand-sized object at a tenth of a millimetre has fewer."""
LARGEST_FRACTION = 2.0
"""If the largest colour of the vertices is at most this, the range is 0..1 (rounding may exceed 1), else
0..255."""
Wrap = Literal["repeat", "mirror", "clamp"]
"""How a texture continues outside 0..1: repeated, mirrored, or with its outermost texels."""


@dataclass(frozen=True, eq=False)
class Material:
    """texture (H, W, 3) uint8 RGB, or None if only `color` (RGB, 0..255) is known; clear: its opacity is
    under one half, apart from its texture; wrap: of the texture, along u and along v."""

    name: str
    color: tuple[int, int, int] = (200, 200, 200)
    texture: UInt8 | None = None
    clear: bool = False
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")


@dataclass(frozen=True, eq=False)
class RawMesh:
    """vertices (V, 3) float64 in the file's unit; faces (F, 3) int32; per face corner, if the file has
    them: uv (F, 3, 2) with v down, colors (F, 3, 3) uint8 RGB; face_materials (F,) int32 into `materials`;
    parts: the names of the file's meshes, if the format has several; notes: what may be wrong with its
    colours, as text."""

    vertices: Float64
    faces: Int32
    uv: Float32 | None
    colors: UInt8 | None
    face_materials: Int32
    materials: tuple[Material, ...]
    parts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def check_count(path: Path, faces: int) -> None:
    """Raises InputError for more than LARGEST_FACES triangles; call it before memory is allocated for
    them."""
    if faces > LARGEST_FACES:
        raise InputError(
            path,
            found=f"{faces} triangles",
            expected=f"at most {LARGEST_FACES}",
            fix=f"{SIMPLIFY}; HuePose keeps 20,000 triangles of it.",
        )


def check_faces(path: Path, vertices: Float, faces: Int) -> None:
    """Raises InputError unless there are finite vertices and faces with valid indices."""
    if len(vertices) == 0 or len(faces) == 0:
        raise InputError(
            path,
            found=f"{len(vertices)} vertices and {len(faces)} faces",
            expected="a triangle mesh",
            fix=RE_EXPORT,
        )
    if not np.isfinite(vertices).all():
        raise InputError(path, found="vertices that are not finite numbers", fix=RE_EXPORT)
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= len(vertices):
        raise InputError(
            path,
            found=f"a face that names vertex {high if high >= len(vertices) else low}",
            expected=f"indices from 0 to {len(vertices) - 1}",
            fix="The file is cut off or damaged. " + RE_EXPORT,
        )
