"""PLY, ascii and binary: colours per vertex, BOP's texture_u and texture_v, MeshLab's texcoord lists.

`comment TextureFile NAME` names the texture's file; without it, an image with the name of the mesh is used.
An ascii body is read as a binary one in which every number is a double.
"""

from __future__ import annotations

import os
import re
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from huepose.geometry.arrays import Float32, Int32, Int64, UInt8
from huepose.onboarding import polygons
from huepose.onboarding.mesh_files import MeshFiles, decoded
from huepose.onboarding.raw_mesh import (
    LARGEST_FRACTION,
    RE_EXPORT,
    Material,
    RawMesh,
    check_count,
    check_faces,
)
from huepose.support.errors import InputError

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = re.compile(rb"[\r\n]end_header[ \t]*(?:\r\n|\r|\n|\Z)")
_U_NAMES, _V_NAMES = ("texture_u", "u", "s"), ("texture_v", "v", "t")


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    count_kind: str | None = None  # type of a list's length; None for a scalar


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


@dataclass(frozen=True)
class _Header:
    form: str
    elements: list[_Element]
    textures: list[str]
    body_at: int


Table = dict[str, Any]  # property name to a column: an array, or a list of arrays for list properties


def read_ply(files: MeshFiles, colored: bool = True) -> RawMesh:
    """Mesh of a PLY file. colored: a mesh without colours is refused; if False, colours are not read and
    the mesh is grey. Raises InputError naming the file and what to do."""
    path = files.mesh
    data = files.read_mesh()
    header = _header(path, data)
    for element in header.elements:
        if any(p.count_kind is not None for p in element.properties):
            check_count(path, element.count)
    try:
        tables = _tables(header, memoryview(data)[header.body_at :])
    except (ValueError, IndexError, ArithmeticError):
        raise InputError(
            path, found="fewer values than its header announces", fix="The file is cut off. " + RE_EXPORT
        ) from None
    vertex = {k: column for k, column in tables.get("vertex", {}).items() if np.ndim(column) == 1}
    face = tables.get("face", {})
    lists = face.get("vertex_indices", face.get("vertex_index"))
    if {"x", "y", "z"} <= vertex.keys() and (lists is None or len(lists) == 0):
        raise InputError(
            path,
            found=f"{len(vertex['x'])} points and no faces",
            expected="a triangle mesh",
            fix="Make a mesh of the points (MeshLab: Screened Poisson), or learn the object by --from-video.",
        )
    if not {"x", "y", "z"} <= vertex.keys() or lists is None or not _is_lists(lists) or len(lists) == 0:
        raise InputError(path, found="no vertices or no faces", expected="a triangle mesh", fix=RE_EXPORT)
    vertices = np.stack([vertex[k] for k in "xyz"], 1).astype(np.float64)
    faces, origin, corners = _triangulated(path, lists)
    check_faces(path, vertices, faces)
    for fan in polygons.left(vertices, faces, origin):
        around = np.asarray(lists[origin[fan.start]], np.int64)
        corners[fan] = polygons.ears(vertices[around], path)
        faces[fan] = around[corners[fan]]
    materials = [Material("")]
    face_materials = np.zeros(len(faces), np.int32)
    if not colored:
        return RawMesh(vertices, faces.astype(np.int32), None, None, face_materials, tuple(materials))
    try:
        uv = _uv(vertex, face, faces, origin, corners)
    except (ValueError, IndexError):
        found = "texture coordinates that do not fit their faces"
        raise InputError(path, found=found, expected="two for each corner", fix=RE_EXPORT) from None
    colors = _vertex_colors(vertex)
    if uv is not None:
        names = header.textures or _textures_beside(path)
        if names:
            materials = [Material(n, texture=files.texture(n, path)) for n in names]
            if len(names) > 1 and not _is_lists(face.get("texnumber", [])):
                face_materials = face["texnumber"][origin].astype(np.int32)
            if face_materials.max() >= len(names):
                found, expected = "a texnumber without texture", f"0 to {len(names) - 1}"
                raise InputError(path, found=found, expected=expected, fix=RE_EXPORT)
            without = face_materials < 0  # MeshLab writes -1 for faces without texture
            if without.any():
                face_materials[without] = len(names)
                materials.append(Material(""))
            else:
                colors = None
        else:
            uv = None
    if uv is None and colors is None:
        raise InputError(
            path,
            found="neither a texture (comment TextureFile and texture coordinates) nor colours per vertex",
            expected="a coloured mesh",
            fix="Export again with texture or vertex colours.",
        )
    corner_colors = None if colors is None else colors[faces]
    return RawMesh(vertices, faces.astype(np.int32), uv, corner_colors, face_materials, tuple(materials))


def _is_lists(column: Any) -> bool:
    """Whether a column belongs to a list property."""
    return isinstance(column, list) or column.ndim == 2


def _header(path: Path, data: bytes) -> _Header:
    end = _END.search(data)
    if not data.startswith(b"ply") or end is None:
        raise InputError(path, found="no PLY header", expected="a PLY file", fix=RE_EXPORT)
    form, elements, textures = "", list[_Element](), list[str]()
    for line in decoded(data[: end.start()]).splitlines():
        words = line.split()
        try:
            match words:
                case ["format", form_name, *_]:
                    form = form_name
                case ["comment", "TextureFile", _, *_]:
                    textures.append(line.split(None, 2)[2].strip())
                case ["element", name, count]:
                    elements.append(_Element(name, _count(count), []))
                case ["property", "list", count_kind, kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count_kind]))
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind]))
                case _:
                    pass
        except (KeyError, ValueError, IndexError):
            raise InputError(
                path, found=f"header line '{line[:60]}'", expected="PLY 1.0", fix=RE_EXPORT
            ) from None
    if form not in _ORDERS:
        found = f"format {form[:20] or 'unknown'}"
        raise InputError(path, found=found, expected="ascii or binary", fix=RE_EXPORT)
    return _Header(form, elements, textures, end.end())


def _count(word: str) -> int:
    number = int(word)
    if number < 0:
        raise ValueError("a negative count")
    return number


def _tables(header: _Header, body: memoryview) -> dict[str, Table]:
    """The elements' tables by name. Raises ValueError, IndexError or ArithmeticError for a damaged body."""
    elements = header.elements
    if header.form == "ascii":
        body = memoryview(_numbers(body)).cast("B")
        elements = [replace(e, properties=[_as_double(p) for p in e.properties]) for e in elements]
    order = _ORDERS[header.form]
    at = 0
    tables: dict[str, Table] = {}
    for element, declared in zip(elements, header.elements, strict=True):
        table, at = _table(element, order, body, at)
        if header.form == "ascii":
            table = {p.name: _cast(table[p.name], p) for p in declared.properties}
        tables[element.name] = table
    return tables


def _numbers(body: memoryview) -> Any:
    """All numbers of an ascii body, float64. Raises ValueError if it has anything else."""
    text = bytes(body).strip()
    if not text:
        return np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # older numpy warns of text that is not a number
        try:
            return np.fromstring(text, sep=" ")
        except DeprecationWarning as error:
            raise ValueError(str(error)) from None


def _as_double(p: _Property) -> _Property:
    return _Property(p.name, "f8", None if p.count_kind is None else "f8")


def _cast(column: Any, p: _Property) -> Any:
    """A column of an ascii file in its declared type. Raises FloatingPointError if it does not fit."""
    with np.errstate(invalid="raise"):
        return [row.astype(p.kind) for row in column] if isinstance(column, list) else column.astype(p.kind)


def _table(element: _Element, order: str, body: memoryview, at: int) -> tuple[Table, int]:
    """The table of an element at byte `at`, and the byte at which the next begins."""
    lists = [p for p in element.properties if p.count_kind is not None]
    dtype = _row_type(element, order, body, at)
    if at + dtype.itemsize * element.count <= len(body):
        rows = np.empty(0, dtype)
        if element.count and dtype.itemsize:
            rows = np.frombuffer(body, dtype, element.count, at)
        if all((rows[f"#{p.name}"] == dtype[p.name].shape[0]).all() for p in lists):
            return {p.name: rows[p.name] for p in element.properties}, at + dtype.itemsize * element.count
    if not lists:
        raise ValueError("cut off")
    return _walk(element, order, body, at)


def _row_type(element: _Element, order: str, body: memoryview, at: int) -> np.dtype[Any]:
    """Type of a row, on the assumption that all rows have lists as long as those of the first row."""
    fields: list[Any] = []
    for p in element.properties:
        if p.count_kind is None:
            fields.append((p.name, order + p.kind))
            continue
        fields.append((f"#{p.name}", order + p.count_kind))
        n = 0
        if element.count:
            offset = at + np.dtype(fields[:-1]).itemsize
            n = int(np.frombuffer(body, order + p.count_kind, 1, offset)[0])
        fields.append((p.name, order + p.kind, (n,)))
    return np.dtype(fields)


def _walk(element: _Element, order: str, body: memoryview, at: int) -> tuple[Table, int]:
    """Rows with lists of different lengths, one by one."""
    table: Table = {p.name: [] for p in element.properties}
    for _ in range(element.count):
        for p in element.properties:
            n = 1
            if p.count_kind is not None:
                count_type = np.dtype(order + p.count_kind)
                n = int(np.frombuffer(body, count_type, 1, at)[0])
                at += count_type.itemsize
            if n < 0:
                raise ValueError("a list of negative length")
            values = np.frombuffer(body, order + p.kind, n, at) if n else np.empty(0, order + p.kind)
            at += values.nbytes
            table[p.name].append(values if p.count_kind is not None else values[0])
    scalars = [p for p in element.properties if p.count_kind is None]
    return table | {p.name: np.array(table[p.name]) for p in scalars}, at


def _triangulated(path: Path, lists: Any) -> tuple[Int64, Int32, Int32]:
    """Polygons as fans: faces (F, 3), the polygon of each (F,), and its corners in that polygon (F, 3)."""
    if isinstance(lists, np.ndarray):
        sizes = np.full(len(lists), lists.shape[1])
        flat = lists.reshape(-1).astype(np.int64)
    else:
        sizes = np.array([len(p) for p in lists])
        flat = np.concatenate(lists).astype(np.int64)
    fans = np.maximum(sizes - 2, 0)
    check_count(path, int(fans.sum()))
    starts = np.cumsum(sizes) - sizes
    origin = np.repeat(np.arange(len(sizes)), fans)
    step = np.arange(len(origin)) - (np.cumsum(fans) - fans)[origin] + 1
    corners = np.stack([np.zeros_like(step), step, step + 1], 1)
    return flat[starts[origin][:, None] + corners], origin.astype(np.int32), corners.astype(np.int32)


def _uv(vertex: Table, face: Table, faces: Int64, origin: Int32, corners: Int32) -> Float32 | None:
    lists = face.get("texcoord")
    u = next((vertex[k] for k in _U_NAMES if k in vertex), None)
    v = next((vertex[k] for k in _V_NAMES if k in vertex), None)
    if isinstance(lists, np.ndarray) and lists.ndim == 2 and lists.shape[1]:
        uv = lists.astype(np.float64).reshape(len(lists), -1, 2)[origin[:, None], corners]
    elif isinstance(lists, list) and any(len(row) for row in lists):
        blank = np.zeros(2 * (int(corners.max()) + 1))
        rows = [np.asarray(row if len(row) else blank, np.float64).reshape(-1, 2) for row in lists]
        uv = np.stack([rows[i][c] for i, c in zip(origin, corners, strict=True)])
    elif u is not None and v is not None:
        uv = np.stack([u, v], 1).astype(np.float64)[faces]
    else:
        return None
    return np.stack([uv[..., 0], 1.0 - uv[..., 1]], -1).astype(np.float32)


def _vertex_colors(vertex: Table) -> UInt8 | None:
    names = next((n for n in (("red", "green", "blue"), ("r", "g", "b")) if set(n) <= vertex.keys()), None)
    if names is None:
        return None
    colors = np.stack([vertex[n] for n in names], 1).astype(np.float64)
    kind, scale = vertex[names[0]].dtype, 1.0
    if kind.kind == "f" and colors.max() <= LARGEST_FRACTION:
        scale = 255.0
    elif (kind.kind, kind.itemsize) == ("u", 2) and colors.max() > 255.0:
        scale = 1.0 / 257.0
    return np.clip(np.round(colors * scale), 0, 255).astype(np.uint8)


def _textures_beside(path: Path) -> list[str]:
    """An image with the name of the mesh, for files that do not name their texture."""
    names = [path.with_suffix(s).name for s in (".png", ".jpg", ".jpeg")]
    return [n for n in names if os.path.exists(path.parent / n)][:1]
