"""Mesh files (OBJ, PLY, GLB, glTF) as `geometry.Mesh`: in metres, with one texture, faces outwards."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int32
from huepose.geometry.mesh import Mesh
from huepose.onboarding.gltf import read_gltf
from huepose.onboarding.kinds import check_kind
from huepose.onboarding.mesh_files import MeshFiles
from huepose.onboarding.obj import read_obj
from huepose.onboarding.ply import read_ply
from huepose.onboarding.raw_mesh import RE_EXPORT, RawMesh
from huepose.onboarding.seams import UPSIDE_DOWN, upside_down
from huepose.onboarding.texture import single_texture
from huepose.onboarding.winding import facing_inwards
from huepose.support.errors import InputError
from huepose.support.lengths import LIKELY, METRES, NAMES, Unit, length, number

SMALLEST_M, LARGEST_M = 0.01, 2.0
"""Limits of the largest side of an object, metres; they decide the unit of a mesh."""
_LEAST_AREA = 1e-6  # of the surface, over the square of the largest side; a wire has more
_MAX_ROUNDING = 1e-3  # of the largest side: a tenth of a millimetre of 10 cm
# Errors that a damaged file may cause in its reader, besides InputError.
_DAMAGE = (ArithmeticError, AttributeError, LookupError, MemoryError, TypeError, ValueError, cv2.error)
_READERS = {".obj": read_obj, ".ply": read_ply, ".glb": read_gltf, ".gltf": read_gltf}


def read_mesh(path: Path | str, unit: Unit | None = None, note: Callable[[str], None] | None = None) -> Mesh:
    """Mesh of a file, in metres, axes as in the file.

    unit: the file's unit of length. Without it, glTF is in metres (its standard), and OBJ and PLY are in
    metres or millimetres, whichever gives a largest side of 1 cm to 2 m. note: is called with texts about
    what may be wrong with the mesh. Raises InputError naming the file, what was found and what to do; for
    an implausible size it shows the size in each unit.
    """
    path = Path(path)
    with np.errstate(all="ignore"), _damage_named(path):  # numbers that are not finite are refused later
        raw = _raw(path)
        if note is not None:
            for text in (*raw.notes, *([UPSIDE_DOWN] if upside_down(raw) else [])):
                note(text)
        return _converted(raw, unit, path)


def read_geometry(path: Path | str, unit: Unit) -> Mesh:
    """Shape of a PLY file as a grey mesh, in metres; it needs no colours, like BOP's `models_eval/`. Raises
    InputError as `read_mesh`."""
    path = Path(path)
    with np.errstate(all="ignore"), _damage_named(path):
        check_kind(path, (".ply",))
        return _converted(read_ply(MeshFiles(path, textured=False), colored=False), unit, path)


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    """Converts errors that damaged content causes into InputError."""
    try:
        yield
    except InputError:
        raise
    except _DAMAGE as error:
        found = f"damaged content ({type(error).__name__}: {str(error)[:80]})"
        raise InputError(path, found=found, expected="a mesh", fix=RE_EXPORT) from None


def unit_of_format(path: Path) -> Unit | None:
    """The unit by the standard of a file's format; None if the standard gives none."""
    return "m" if _READERS.get(path.suffix.lower()) is read_gltf else None


@dataclass(frozen=True)
class Looked:
    """Properties of a mesh before its unit is decided.

    sizes: its largest side in metres, for each unit in which this is the size of an object, likely units
    first; parts: the names of the meshes that are merged; away: distance of the centre of its bounds from
    its origin, and diameter: diagonal of its bounds, in the file's unit; clear: share of its surface that
    is transparent, by texture or material; transparent surfaces are read as opaque."""

    sizes: dict[Unit, float]
    parts: tuple[str, ...]
    away: float
    diameter: float
    clear: float


def look_at(path: Path) -> Looked:
    """Properties of a mesh file. Raises InputError as `read_mesh`."""
    with np.errstate(all="ignore"), _damage_named(path):
        raw = _raw(path, textured=False)  # decoding a large texture takes seconds
        vertices = _referenced(raw)[0]
        side, low, high = _extent(vertices), vertices.min(0), vertices.max(0)
        clear = _clear_share(raw)
    units = dict.fromkeys((*LIKELY, *METRES))
    sizes = {unit: side * METRES[unit] for unit in units if SMALLEST_M <= side * METRES[unit] <= LARGEST_M}
    away, diameter = float(np.linalg.norm((low + high) / 2.0)), float(np.linalg.norm(high - low))
    return Looked(sizes, raw.parts, away, diameter, clear)


_INSIDE = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4], [4, 4, 1], [4, 1, 4], [1, 4, 4]], float)
"""Points of a triangle at which its texture is read: barycentric coordinates, not normalised."""


def _clear_share(raw: RawMesh) -> float:
    """Share of the surface whose material is clear or whose texels are white, for a mesh that was read with
    `textured=False`."""
    places = _INSIDE / _INSIDE.sum(1, keepdims=True)
    a, b, c = (raw.vertices[raw.faces[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    clear = 0.0
    for k, material in enumerate(raw.materials):
        mine = raw.face_materials == k
        if material.clear:
            clear += float(areas[mine].sum())
            continue
        if raw.uv is None or material.texture is None or not material.texture.any():
            continue
        height, width = material.texture.shape[:2]
        u, v = np.moveaxis(places @ raw.uv[mine].astype(float) % 1.0, -1, 0)
        white = material.texture[(v * height).astype(int) % height, (u * width).astype(int) % width].any(-1)
        clear += float((white.mean(1) * areas[mine]).sum())
    return clear / max(float(areas.sum()), np.finfo(float).tiny)


def _raw(path: Path, textured: bool = True) -> RawMesh:
    """The mesh as in the file; textured: with its textures."""
    if path.is_dir():
        raise InputError(
            path, found="a folder", expected=f"a mesh file: {', '.join(_READERS)}", fix=_inside(path)
        )
    check_kind(path, _READERS)
    return _READERS[path.suffix.lower()](MeshFiles(path, textured))


def _inside(folder: Path) -> str:
    """Advice for a folder: which of its meshes may be meant."""
    there = sorted(path for path in folder.iterdir() if path.suffix.lower() in _READERS)
    return f"Did you mean {there[0]}?" if there else "Name the file itself; this folder has none."


def _converted(raw: RawMesh, unit: Unit | None, path: Path) -> Mesh:
    vertices, faces = _referenced(raw)
    scale = _metres_per_unit(vertices, unit or unit_of_format(path), unit is not None, path)
    metric = (vertices * scale).astype(np.float32)
    _check_rounding(metric, path)
    uv, texture = single_texture(raw, path)
    inwards = facing_inwards(metric, faces)
    faces[inwards], uv[inwards] = faces[inwards, ::-1], uv[inwards, ::-1]
    mesh = Mesh(metric, np.ascontiguousarray(faces), np.ascontiguousarray(uv), texture)
    if not mesh.face_normals()[1].sum() > _LEAST_AREA * _extent(metric.astype(np.float64)) ** 2:
        found = "triangles without area: the corners of each are in one place or line"
        raise InputError(path, found=found, expected="an object", fix=RE_EXPORT)
    return mesh


def _check_rounding(metric: Float32, path: Path) -> None:
    """Raises InputError for vertices (V, 3), metres, so far from their origin that rounding to 32 bits
    changes the shape."""
    step = float(np.spacing(np.abs(metric).max()))
    if not step <= _MAX_ROUNDING * _extent(metric.astype(np.float64)):  # also for infinity
        away = float(np.linalg.norm((metric.min(0) + metric.max(0)) / 2.0))
        raise InputError(
            path,
            found=f"a mesh {length(away)} from its origin, where 32 bits round positions to {length(step)}",
            expected="an origin in or near the object, not that of a map",
            fix="Move the mesh to its origin in the modelling program, and export again.",
        )


def _referenced(raw: RawMesh) -> tuple[Float64, Int32]:
    """The vertices that faces use, in their order, and the faces with new indices."""
    used = np.zeros(len(raw.vertices), bool)
    used[raw.faces] = True
    numbers = np.cumsum(used) - 1
    return raw.vertices[used], numbers[raw.faces].astype(np.int32)


def _extent(vertices: Float64) -> float:
    """The largest side, in the unit of the vertices (V, 3)."""
    return float((vertices.max(0) - vertices.min(0)).max())


def _metres_per_unit(vertices: Float64, unit: Unit | None, was_given: bool, path: Path) -> float:
    extent = _extent(vertices)
    if extent == 0.0:
        found = "a mesh without size: all its points are in one place"
        raise InputError(path, found=found, expected="an object", fix=RE_EXPORT)
    tried = LIKELY if unit is None else (unit,)
    plausible = [u for u, s in METRES.items() if SMALLEST_M <= extent * s <= LARGEST_M]
    taken = next((u for u in tried if u in plausible), None)
    if taken is not None:
        return METRES[taken]
    sizes = " or ".join(f"{length(extent * METRES[u])} if it is in {NAMES[u]}" for u in (*tried, *plausible))
    options = " or ".join(f"--unit {u}" for u in plausible)
    if plausible:
        fix = f"Did you mean {options}?" if was_given else f"Give {options}."
    else:
        fix = f"No --unit ({', '.join(METRES)}) gives that size: scale the mesh."
    raise InputError(
        path,
        found=f"a largest side of {number(extent)} units{f' (taken as {unit})' if unit else ''}: {sizes}",
        expected=f"an object of {length(SMALLEST_M)} to {length(LARGEST_M)}",
        fix=fix,
    )
