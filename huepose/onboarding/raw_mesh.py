"""What a mesh file says, before units and textures are settled: the common ground of the readers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64, Int, Int32, UInt8
from huepose.support.errors import InputError

RE_EXPORT = "Export the mesh again as OBJ, PLY or GLB with its texture."


@dataclass(frozen=True, eq=False)
class Material:
    """texture (H, W, 3) uint8 RGB, or None where only `color` (RGB, 0..255) is known."""

    name: str
    color: tuple[int, int, int] = (200, 200, 200)
    texture: UInt8 | None = None


@dataclass(frozen=True, eq=False)
class RawMesh:
    """vertices (V, 3) float64 in the file's unit; faces (F, 3) int32; per face corner, where the file has
    them: uv (F, 3, 2) with v down, colors (F, 3, 3) uint8 RGB; face_materials (F,) int32 into `materials`."""

    vertices: Float64
    faces: Int32
    uv: Float32 | None
    colors: UInt8 | None
    face_materials: Int32
    materials: tuple[Material, ...]


def check_faces(path: Path, vertices: Float, faces: Int) -> None:
    """Raises InputError unless there are finite vertices, and faces that point at them."""
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


def read_bytes(path: Path, role: str, named_in: Path | None = None) -> bytes:
    """Content of a file; raises InputError that says which file named it."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        where = f", which {named_in.name} names" if named_in else ""
        raise InputError(
            path, found="no such file", expected=f"the {role}{where}", fix=_missing_fix(role, named_in)
        ) from None
    except OSError as error:
        raise InputError(path, found=str(error), expected=f"a readable {role}") from None


def _missing_fix(role: str, named_in: Path | None) -> str:
    if named_in is None:
        return "Check the path."
    return f"Put the {role} beside {named_in.name}, or correct the name in it."


def read_texture(path: Path, named_in: Path) -> UInt8:
    """Image file named in a mesh or material file, as (H, W, 3) uint8 RGB.

    Names that differ in case only are forgiven, and folders of the machine that exported the mesh.
    """
    if not path.exists():
        places = [path.parent, named_in.parent]
        alike = [p for folder in places for p in _listing(folder) if p.name.lower() == path.name.lower()]
        path = alike[0] if alike else path
    return decode_texture(read_bytes(path, "texture", named_in), str(path))


def _listing(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def decode_texture(data: bytes, what: str) -> UInt8:
    """PNG, JPEG and so on to (H, W, 3) uint8 RGB; raises InputError naming `what`."""
    image = None
    if data:
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if image is None:
        raise InputError(
            what,
            found=f"{len(data)} bytes that are no picture",
            expected="a PNG or JPEG texture",
            fix="Open the texture in an image editor and save it again as PNG.",
        )
    return np.ascontiguousarray(image[..., ::-1])
