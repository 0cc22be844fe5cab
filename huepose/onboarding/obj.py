"""Wavefront OBJ with its MTL: all forms of faces, negative indices, polygons, several materials.

Colours come from `map_Kd`, else from six-number vertices (x y z r g b), else from `Kd`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from huepose.onboarding.raw_mesh import RE_EXPORT, Material, RawMesh, check_faces, read_bytes, read_texture
from huepose.support.errors import InputError

_MAP_OPTION_ARGUMENTS = {"-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1}
_MAP_OPTION_ARGUMENTS |= {"-imfchan": 1, "-mm": 2, "-texres": 1, "-type": 1}


@dataclass
class _Lines:
    """The statements of an OBJ file, sorted by kind."""

    v: list[list[str]] = field(default_factory=list)
    vt: list[list[str]] = field(default_factory=list)
    corners: list[tuple[int, int]] = field(default_factory=list)  # vertex, texture vertex or -1; 3 a face
    face_materials: list[int] = field(default_factory=list)
    material_names: list[str] = field(default_factory=list)
    libraries: list[str] = field(default_factory=list)


def read_obj(path: Path) -> RawMesh:
    """Mesh of an OBJ file. Raises InputError naming the file, the line and what to do."""
    lines = _statements(path)
    try:
        v = np.array([row[:6] if len(row) >= 6 else row[:3] for row in lines.v], np.float64)
        vt = np.array([row[:2] for row in lines.vt], np.float64).reshape(-1, 2)
    except ValueError:
        raise InputError(path, found="a vertex that is not made of numbers", fix=RE_EXPORT) from None
    corners = np.array(lines.corners, np.int64).reshape(-1, 3, 2)
    faces = corners[..., 0].astype(np.int32)
    check_faces(path, v, faces)
    if v.ndim != 2 or v.shape[1] not in (3, 6):
        raise InputError(path, found="vertices of different lengths", expected="x y z, or x y z r g b")
    if len(vt) and corners[..., 1].max() >= len(vt):
        found = f"texture coordinate {corners[..., 1].max() + 1}"
        raise InputError(path, found=found, expected=f"1 to {len(vt)}", fix=RE_EXPORT)
    uv = None
    if len(vt) and (corners[..., 1] >= 0).any():
        uv = vt[corners[..., 1]].astype(np.float32)
        uv[..., 1] = 1.0 - uv[..., 1]
        uv[corners[..., 1] < 0] = 0.0
    colors = None
    if v.shape[1] == 6:
        scale = 255.0 if v[:, 3:].max() <= 1.0 else 1.0
        colors = np.clip(np.round(v[:, 3:] * scale), 0, 255).astype(np.uint8)[faces]
    face_materials = np.array(lines.face_materials, np.int32)
    used = np.unique(face_materials)
    materials = _materials(path, lines, [lines.material_names[i] for i in used])
    for i, material in zip(used, materials, strict=True):
        naked = uv is None or (corners[face_materials == i, :, 1] < 0).any()
        if material.texture is not None and naked:
            raise InputError(
                path,
                found=f"material {material.name} with a texture, but faces of it without vt",
                expected="faces as v/vt or v/vt/vn",
                fix="Export again with texture coordinates (UVs) switched on.",
            )
    if colors is None and all(m.name == "" for m in materials):
        raise InputError(
            path,
            found="no mtllib, and no colours at the vertices",
            expected="a textured mesh",
            fix="Export again with materials and texture (an .mtl and an image beside the .obj).",
        )
    renumbered = np.searchsorted(used, face_materials).astype(np.int32)
    return RawMesh(np.ascontiguousarray(v[:, :3]), faces, uv, colors, renumbered, materials)


def _statements(path: Path) -> _Lines:
    text = read_bytes(path, "mesh").decode("utf-8", errors="replace").replace("\\\n", " ")
    out = _Lines()
    current = -1
    numbers: dict[str, int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        kind = words[0]
        if kind == "v":
            out.v.append(words[1:])
        elif kind == "vt":
            out.vt.append(words[1:])
        elif kind == "f":
            if current < 0:
                current = numbers.setdefault("", len(out.material_names))
                out.material_names.append("")
            try:
                corners = [_corner(word, len(out.v), len(out.vt)) for word in words[1:]]
            except ValueError:
                raise InputError(
                    f"{path} line {number}", found=line.strip()[:60], expected="f v, v/vt, v//vn or v/vt/vn"
                ) from None
            for k in range(1, len(corners) - 1):
                out.corners += (corners[0], corners[k], corners[k + 1])
                out.face_materials.append(current)
        elif kind == "usemtl":
            name = line.split(None, 1)[1].strip() if len(words) > 1 else ""
            if name not in numbers:
                numbers[name] = len(out.material_names)
                out.material_names.append(name)
            current = numbers[name]
        elif kind == "mtllib" and len(words) > 1:
            out.libraries.append(line.split(None, 1)[1].strip())
    return out


def _corner(word: str, vertices: int, texture_vertices: int) -> tuple[int, int]:
    parts = word.split("/")
    v = int(parts[0])
    t = int(parts[1]) if len(parts) > 1 and parts[1] else 0
    if v == 0:
        raise ValueError("indices count from 1")
    return (v - 1 if v > 0 else vertices + v), (t - 1 if t > 0 else texture_vertices + t if t < 0 else -1)


def _materials(path: Path, lines: _Lines, names: list[str]) -> tuple[Material, ...]:
    known: dict[str, Material] = {}
    for library in lines.libraries:
        known |= _read_mtl(_library_path(path, library), path)
    only_default = len(known) == 1 and names == [""]
    if only_default:  # exporters that name a library but forget `usemtl`
        return tuple(known.values())
    missing = [name for name in names if name and name not in known]
    if missing:
        libraries = ", ".join(lines.libraries) or "no mtllib"
        raise InputError(
            path,
            found=f"usemtl {missing[0]}",
            expected=f"that material in {libraries} (there: {', '.join(known) or 'none'})",
            fix="Put the .mtl that belongs to the mesh beside it, or export again.",
        )
    return tuple(known.get(name, Material("")) for name in names)


def _library_path(path: Path, name: str) -> Path:
    return path.parent / name.replace("\\", "/")


def _read_mtl(mtl: Path, obj: Path) -> dict[str, Material]:
    text = read_bytes(mtl, "material file", obj).decode("utf-8", errors="replace")
    colors: dict[str, tuple[int, int, int]] = {}
    maps: dict[str, str] = {}
    name = ""
    for line in text.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "newmtl":
            name = line.split(None, 1)[1].strip() if len(words) > 1 else ""
            colors[name] = (200, 200, 200)
        elif words[0] == "Kd" and len(words) >= 4:
            try:
                r, g, b = (min(255, max(0, round(255 * float(w)))) for w in words[1:4])
            except ValueError:
                raise InputError(mtl, found=line.strip(), expected="Kd r g b with numbers 0..1") from None
            colors[name] = (r, g, b)
        elif words[0] == "map_Kd" and len(words) > 1:
            maps[name] = _map_file(mtl, line)
    return {
        n: Material(n, c, read_texture(mtl.parent / maps[n], mtl) if n in maps else None)
        for n, c in colors.items()
    }


def _map_file(mtl: Path, line: str) -> str:
    """File name of a `map_Kd` line: options are skipped, spaces in the name are kept."""
    rest = line.split(None, 1)[1].strip()
    while rest.startswith("-"):
        words = rest.split()
        option = words[0]
        if option in ("-s", "-o", "-t"):
            count = 0
            while count < 3 and _is_number(words[1 + count]):
                count += 1
            neutral = 1.0 if option == "-s" else 0.0
            if any(float(w) != neutral for w in words[1 : 1 + count]):
                raise InputError(
                    mtl, found=line.strip(), expected="map_Kd without scale or offset", fix=RE_EXPORT
                )
        else:
            count = _MAP_OPTION_ARGUMENTS.get(option, 0)
        rest = rest.split(None, 1 + count)[-1]
    return rest.replace("\\", "/")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
