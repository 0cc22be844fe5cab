"""PLY, ascii and binary: colours per vertex, BOP's texture_u and texture_v, MeshLab's texcoord lists.

The texture's file is named by `comment TextureFile NAME`. (open3d drops texture coordinates of PLY, hence
our own reader.)
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huepose.geometry.arrays import Float32, Int32, UInt8
from huepose.onboarding.raw_mesh import RE_EXPORT, Material, RawMesh, check_faces, read_bytes, read_texture
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
_U_NAMES, _V_NAMES = ("texture_u", "u", "s"), ("texture_v", "v", "t")


@dataclass
class _Property:
    name: str
    kind: str
    count_kind: str | None = None  # of a list


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property]


@dataclass
class _Header:
    form: str
    elements: list[_Element]
    textures: list[str]
    body: bytes


Table = dict[str, Any]  # property name to a column: an array, or a list of arrays for list properties


def read_ply(path: Path) -> RawMesh:
    """Mesh of a PLY file. Raises InputError naming the file and what to do."""
    header = _header(path)
    read = _ascii_tables if header.form == "ascii" else _binary_tables
    try:
        tables = read(header)
    except (ValueError, IndexError):
        raise InputError(
            path, found="fewer values than its header announces", fix="The file is cut off. " + RE_EXPORT
        ) from None
    vertex, face = tables.get("vertex", {}), tables.get("face", {})
    lists = face.get("vertex_indices", face.get("vertex_index"))
    if not {"x", "y", "z"} <= vertex.keys() or lists is None or len(lists) == 0:
        raise InputError(path, found="no vertices or no faces", expected="a triangle mesh", fix=RE_EXPORT)
    vertices = np.stack([vertex[k] for k in "xyz"], 1).astype(np.float64)
    corner_lists = [np.asarray(polygon, np.int64) for polygon in lists]
    faces, origin, corners = _triangulated(corner_lists)
    check_faces(path, vertices, faces)
    uv = _uv(vertex, face, faces, origin, corners)
    colors = _vertex_colors(vertex)
    materials = [Material("")]
    face_materials = np.zeros(len(faces), np.int32)
    if uv is not None:
        names = header.textures or _textures_beside(path)
        if names:
            materials = [Material(n, texture=read_texture(path.parent / n, path)) for n in names]
            if "texnumber" in face and len(names) > 1:
                face_materials = np.asarray(face["texnumber"])[origin].astype(np.int32)
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
    if face_materials.min() < 0 or face_materials.max() >= len(materials):
        raise InputError(
            path, found="a texnumber without texture", expected=f"0 to {len(materials) - 1}", fix=RE_EXPORT
        )
    corner_colors = None if colors is None else colors[faces]
    return RawMesh(vertices, faces, uv, corner_colors, face_materials, tuple(materials))


def _header(path: Path) -> _Header:
    data = read_bytes(path, "mesh")
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise InputError(path, found="no PLY header", expected="a PLY file", fix=RE_EXPORT)
    body = data[data.index(b"\n", end) + 1 :] if b"\n" in data[end:] else b""
    form, elements, textures = "", list[_Element](), list[str]()
    for line in data[:end].decode("latin-1").splitlines():
        words = line.split()
        try:
            match words:
                case ["format", form_name, *_]:
                    form = form_name
                case ["comment", "TextureFile", *_]:
                    textures.append(line.split(None, 2)[2].strip().replace("\\", "/"))
                case ["element", name, count]:
                    elements.append(_Element(name, int(count), []))
                case ["property", "list", count_kind, kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count_kind]))
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind]))
                case _:
                    pass
        except (KeyError, ValueError, IndexError):
            raise InputError(path, found=f"header line '{line}'", expected="PLY 1.0", fix=RE_EXPORT) from None
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise InputError(path, found=f"format {form or 'unknown'}", expected="ascii or binary", fix=RE_EXPORT)
    return _Header(form, elements, textures, body)


def _ascii_tables(header: _Header) -> dict[str, Table]:
    words = header.body.split()
    at = 0
    tables: dict[str, Table] = {}
    for element in header.elements:
        if all(p.count_kind is None for p in element.properties):
            width = len(element.properties)
            block = np.array(words[at : at + width * element.count], np.float64)
            block = block.reshape(element.count, width)
            columns = enumerate(element.properties)
            tables[element.name] = {p.name: block[:, k].astype(p.kind) for k, p in columns}
            at += width * element.count
            continue
        table: Table = {p.name: [] for p in element.properties}
        for _ in range(element.count):
            for p in element.properties:
                if p.count_kind is None:
                    table[p.name].append(float(words[at]))
                    at += 1
                else:
                    n = int(words[at])
                    if at + n >= len(words):
                        raise ValueError("cut off")
                    table[p.name].append([float(w) for w in words[at + 1 : at + 1 + n]])
                    at += 1 + n
        tables[element.name] = table
    return tables


def _binary_tables(header: _Header) -> dict[str, Table]:
    order = "<" if header.form == "binary_little_endian" else ">"
    at = 0
    tables: dict[str, Table] = {}
    for element in header.elements:
        dtype = _row_type(element, order, header.body, at)
        rows = np.frombuffer(header.body, dtype, element.count, at)
        lists = [p for p in element.properties if p.count_kind is not None]
        if all((rows[f"#{p.name}"] == dtype[p.name].shape[0]).all() for p in lists):
            tables[element.name] = {p.name: rows[p.name] for p in element.properties}
            at += dtype.itemsize * element.count
        else:
            tables[element.name], at = _walk(element, order, header.body, at)
    return tables


def _row_type(element: _Element, order: str, body: bytes, at: int) -> np.dtype[Any]:
    """Type of a row if all rows have lists as long as the first row's."""
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


def _walk(element: _Element, order: str, body: bytes, at: int) -> tuple[Table, int]:
    """Rows with lists of different lengths, one by one."""
    table: Table = {p.name: [] for p in element.properties}
    for _ in range(element.count):
        for p in element.properties:
            n = 1
            if p.count_kind is not None:
                count_type = np.dtype(order + p.count_kind)
                n = int(np.frombuffer(body, count_type, 1, at)[0])
                at += count_type.itemsize
            values = np.frombuffer(body, order + p.kind, n, at)
            at += values.nbytes
            table[p.name].append(values if p.count_kind is not None else values[0])
    return table, at


def _triangulated(polygons: list[Any]) -> tuple[Int32, Int32, Int32]:
    """Fans: faces (F, 3), the polygon each came from (F,), and its corners within that polygon (F, 3)."""
    if all(len(p) == 3 for p in polygons):
        count = len(polygons)
        corners = np.tile(np.arange(3, dtype=np.int32), (count, 1))
        return np.array(polygons).astype(np.int32), np.arange(count, dtype=np.int32), corners
    rows = [(i, 0, k, k + 1) for i, p in enumerate(polygons) for k in range(1, len(p) - 1)]
    table = np.array(rows, np.int32).reshape(-1, 4)
    faces = np.array([[polygons[i][a], polygons[i][b], polygons[i][c]] for i, a, b, c in rows], np.int32)
    return faces.reshape(-1, 3), table[:, 0].copy(), table[:, 1:].copy()


def _uv(vertex: Table, face: Table, faces: Int32, origin: Int32, corners: Int32) -> Float32 | None:
    lists = face.get("texcoord")
    u = next((vertex[k] for k in _U_NAMES if k in vertex), None)
    v = next((vertex[k] for k in _V_NAMES if k in vertex), None)
    if lists is not None and any(len(row) for row in lists):
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
    is_fraction = vertex[names[0]].dtype.kind == "f" and colors.max() <= 1.0
    return np.clip(np.round(colors * (255.0 if is_fraction else 1.0)), 0, 255).astype(np.uint8)


def _textures_beside(path: Path) -> list[str]:
    """A picture of the mesh's own name, for files whose writer forgot to name it."""
    names = [path.with_suffix(s).name for s in (".png", ".jpg", ".jpeg")]
    return [n for n in names if (path.parent / n).exists()][:1]
