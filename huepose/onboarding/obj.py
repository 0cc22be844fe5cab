"""Wavefront OBJ: all forms of faces, negative indices, polygons; materials with the colour `Kd` and the
texture `map_Kd`, or `map_Ka` if there is no `map_Kd`.

Colours come from textures, without texture from vertices with six numbers (x y z r g b), without these from
`Kd`. `Kd` is also used if all vertices have the same grey and the materials have colours: exporters write
such a grey, or white, for vertices without colours.

Vertices and texture coordinates keep their separate indices, as in the file. Common indices would repeat
vertices along every seam of the texture, and would change pose errors, which are means over vertices.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import numpy as np

from huepose.geometry.arrays import Float64, Int64, UInt8
from huepose.onboarding import polygons
from huepose.onboarding.mesh_files import MeshFiles, decoded
from huepose.onboarding.raw_mesh import (
    LARGEST_FRACTION,
    RE_EXPORT,
    Material,
    RawMesh,
    Wrap,
    check_count,
    check_faces,
)
from huepose.support.errors import InputError

_MAP_OPTION_ARGUMENTS = {"-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1}
_MAP_OPTION_ARGUMENTS |= {"-imfchan": 1, "-mm": 2, "-texres": 1, "-type": 1}
"""Number of words after each option of a texture in a material file."""

_GREY = (200, 200, 200)
"""RGB of a material that states no colour."""

_LIBRARY = "material file"


def read_materials(
    files: MeshFiles, libraries: Sequence[str], wanted: Collection[str]
) -> tuple[dict[str, Material], list[str], list[str]]:
    """The `wanted` materials of an OBJ file's libraries by name, the names of all materials in them, and
    notes on materials whose textures do not give their colour.

    The textures of other materials are not read. A single material is always read. Raises InputError naming
    the file, what was found and what to do.
    """
    colors: dict[str, tuple[int, int, int]] = {}
    maps: dict[str, tuple[Path, dict[str, str]]] = {}
    opacities: dict[str, float] = {}
    for library in libraries:
        path, data = files.read(library, _LIBRARY, files.mesh)
        in_library, maps_in_library, opacities_in_library = _parsed(path, decoded(data))
        for name, color in in_library.items():
            colors[name] = color
            maps.pop(name, None)
            opacities.pop(name, None)
        opacities |= opacities_in_library
        maps |= {name: (path, lines) for name, lines in maps_in_library.items()}
    materials, notes = {}, []
    for name, color in colors.items():
        if name in wanted or len(colors) == 1:
            texture: UInt8 | None = None
            wrap: Wrap = "repeat"
            if name in maps:
                path, lines = maps[name]
                line = lines.get("map_kd", lines.get("map_ka"))
                if line is None:
                    notes.append(_no_color_map(name, lines))
                else:
                    file, wrap = _map_file(path, line)
                    texture = files.texture(_unquoted(files, file, path), path)
            clear = opacities.get(name, 1.0) < 0.5
            materials[name] = Material(name, color, texture, clear, (wrap, wrap))
    return materials, list(colors), notes


def _unquoted(files: MeshFiles, name: str, mtl: Path) -> str:
    """The name without its quotes, unless a file with the quotes in its name exists."""
    quoted = len(name) > 2 and name[0] == name[-1] and name[0] in "\"'"
    return name[1:-1] if quoted and not files.has(name, "texture", mtl) else name


def _no_color_map(name: str, lines: dict[str, str]) -> str:
    there = ", ".join(line.strip()[:60] for line in lines.values())
    return (
        f"material {name} has no colour texture (map_Kd), only {there}; it gets one colour (Kd). If that is "
        "wrong, name its colour texture with map_Kd in the material file"
    )


def _libraries(files: MeshFiles, line: str) -> list[str]:
    """The material files that `mtllib` names: one whose name may have spaces, or several."""
    words = line.split()
    several = not files.has(line, _LIBRARY, files.mesh) and files.has(words[0], _LIBRARY, files.mesh)
    return words if several else [line]


def _parsed(
    mtl: Path, text: str
) -> tuple[dict[str, tuple[int, int, int]], dict[str, dict[str, str]], dict[str, float]]:
    """By the name of their material: colours, lines `map_...` by their first word, and opacities if
    given."""
    colors: dict[str, tuple[int, int, int]] = {}
    maps: dict[str, dict[str, str]] = {}
    opacities: dict[str, float] = {}
    name = ""
    for line in text.splitlines():
        words = line.split()
        if not words:
            continue
        kind = words[0].lower()  # some exporters write MAP_KD
        if kind == "newmtl":
            name = line.split(None, 1)[1].strip() if len(words) > 1 else ""
            colors[name] = _GREY
        elif kind == "kd" and len(words) >= 4:
            try:
                r, g, b = (min(255, max(0, round(255 * float(w)))) for w in words[1:4])
            except (ValueError, OverflowError):
                found = line.strip()[:60]
                raise InputError(mtl, found=found, expected="Kd r g b with numbers 0..1") from None
            colors[name] = (r, g, b)
        elif kind.startswith("map_") and kind != "map_aat" and len(words) > 1:  # map_aat names no texture
            maps.setdefault(name, {})[kind] = line
        elif kind == "d" and _is_number(words[-1]):  # before it there may be `-halo`
            opacities[name] = float(words[-1])
        elif kind == "tr" and _is_number(words[-1]):  # some exporters mean the opposite of it: `d` counts
            opacities.setdefault(name, 1.0 - float(words[-1]))
    return colors, maps, opacities


def _map_file(mtl: Path, line: str) -> tuple[str, Wrap]:
    """File name of a `map_Kd` line, and how the texture continues outside 0..1. Other options are skipped;
    spaces in the name are kept."""
    wrap: Wrap = "repeat"
    rest = line.split(None, 1)[1].strip()
    while rest.startswith("-"):
        words = rest.split()
        option = words[0]
        if option in ("-s", "-o", "-t"):
            count = 0
            while count < 3 and 1 + count < len(words) and _is_number(words[1 + count]):
                count += 1
            neutral = 1.0 if option == "-s" else 0.0
            if any(float(w) != neutral for w in words[1 : 1 + count]):
                raise InputError(
                    mtl, found=line.strip(), expected="map_Kd without scale or offset", fix=RE_EXPORT
                )
        else:
            count = _MAP_OPTION_ARGUMENTS.get(option, 0)
        if len(words) < 2 + count:
            raise InputError(
                mtl, found=line.strip()[:60], expected="the name of a texture after map_Kd", fix=RE_EXPORT
            )
        if option == "-clamp":
            wrap = "clamp" if words[1] == "on" else "repeat"
        rest = rest.split(None, 1 + count)[-1]
    return rest, wrap


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


_FORMS = {
    "v": "v x y z, or v x y z r g b, like the vertices before it",
    "vt": "vt u v",
    "f": "f v, v/vt, v//vn or v/vt/vn",
}
_LONGEST_LINE = 1_000_000  # characters: a polygon of some hundred thousand corners is not a face of an object


@dataclass
class _Statements:
    """The statements of an OBJ file, sorted by kind."""

    v: array[float] = field(default_factory=lambda: array("d"))  # x y z, or x y z r g b, one after the other
    v_width: int = 0  # numbers of a vertex: 3 or 6
    vt: array[float] = field(default_factory=lambda: array("d"))  # u v
    corners: array[int] = field(default_factory=lambda: array("q"))  # v and vt (or -1), three pairs per face
    polygons: array[int] = field(default_factory=lambda: array("q"))  # the polygon of each face
    face_materials: array[int] = field(default_factory=lambda: array("q"))
    material_names: list[str] = field(default_factory=list)
    libraries: list[str] = field(default_factory=list)


def read_obj(files: MeshFiles) -> RawMesh:
    """Mesh of an OBJ file. Raises InputError naming the file, the line and what to do."""
    path = files.mesh
    statements = _statements(path, decoded(files.read_mesh()))
    v = np.array(statements.v, np.float64).reshape(-1, max(statements.v_width, 3))
    vt = np.array(statements.vt, np.float64).reshape(-1, 2)
    corners = np.array(statements.corners, np.int64).reshape(-1, 3, 2)
    check_faces(path, v, corners[..., 0])
    _cut_by_ears(path, v, corners, np.array(statements.polygons, np.int64))
    faces = corners[..., 0].astype(np.int32)
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
        scale = 255.0 if v[:, 3:].max() <= LARGEST_FRACTION else 1.0
        colors = np.clip(np.round(v[:, 3:] * scale), 0, 255).astype(np.uint8)[faces]
    face_materials = np.array(statements.face_materials, np.int32)
    used = np.unique(face_materials)
    colored = colors is not None and not _one_grey(colors)
    materials, notes = _materials(files, statements, [statements.material_names[i] for i in used], colored)
    for i, material in zip(used, materials, strict=True):
        naked = uv is None or (corners[face_materials == i, :, 1] < 0).any()
        if material.texture is not None and naked:
            raise InputError(
                path,
                found=f"material {material.name} with a texture, but faces of it without vt",
                expected="faces as v/vt or v/vt/vn",
                fix="Export again with texture coordinates (UVs) switched on.",
            )
    if colors is not None and _one_grey(colors) and _have_colors(materials):
        colors = None
    if colors is None and all(m.name == "" for m in materials):
        raise InputError(
            path,
            found="no mtllib, and no colours at the vertices",
            expected="a textured mesh",
            fix="Export again with materials and texture (an .mtl and an image beside the .obj).",
        )
    renumbered = np.searchsorted(used, face_materials).astype(np.int32)
    vertices = np.ascontiguousarray(v[:, :3])
    return RawMesh(vertices, faces, uv, colors, renumbered, materials, notes=tuple(notes))


def _one_grey(colors: UInt8) -> bool:
    """Whether the colours (F, 3, 3) of corners are all the same grey, or white."""
    return bool((colors == colors.flat[0]).all())


def _have_colors(materials: Sequence[Material]) -> bool:
    """Whether the materials without a texture have several colours, or one that is not grey."""
    colors = {material.color for material in materials if material.texture is None}
    return len(colors) > 1 or any(len(set(color)) > 1 for color in colors)


def _statements(path: Path, text: str) -> _Statements:
    out = _Statements()
    current = -1
    numbers: dict[str, int] = {}
    for number, line in _lines(path, text):
        words = line.split()
        if not words:
            continue
        kind = words[0]
        try:
            if kind == "v":
                _add_vertex(out, words)
            elif kind == "vt":
                out.vt.extend((float(words[1]), float(words[2]) if len(words) > 2 else 0.0))
            elif kind == "f":
                if current < 0:
                    current = numbers.setdefault("", len(out.material_names))
                    out.material_names.append("")
                _add_face(out, words, current)
                check_count(path, len(out.face_materials))
            elif kind == "usemtl":
                name = line.split(None, 1)[1].strip() if len(words) > 1 else ""
                if name not in numbers:
                    numbers[name] = len(out.material_names)
                    out.material_names.append(name)
                current = numbers[name]
            elif kind == "mtllib" and len(words) > 1:
                out.libraries.append(line.split(None, 1)[1].strip())
        except InputError:
            raise
        except (ValueError, IndexError, OverflowError):
            found = line.strip()[:60]
            raise InputError(
                f"{path} line {number}", found=found, expected=_FORMS[kind], fix=RE_EXPORT
            ) from None
    return out


def _lines(path: Path, text: str) -> Iterator[tuple[int, str]]:
    """Lines with their numbers. A line that ends with a backslash continues in the next, unless it is a
    comment."""
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    start = 0
    parts: list[str] = []
    for number in count(1):
        end = text.find("\n", start)
        line = text[start : end if end >= 0 else len(text)]
        if len(line) > _LONGEST_LINE:
            found = f"a line of {len(line)} characters"
            raise InputError(f"{path} line {number}", found=found, expected="an OBJ file", fix=RE_EXPORT)
        goes_on = line.endswith("\\") and end >= 0 and not line.lstrip().startswith("#")
        parts.append(line[:-1] if goes_on else line)
        if not goes_on:
            yield number, " ".join(parts)
            parts = []
        if end < 0:
            return
        start = end + 1


def _add_vertex(out: _Statements, words: list[str]) -> None:
    width = 6 if len(words) >= 7 else 3
    row = [float(word) for word in words[1 : 1 + width]]
    out.v_width = out.v_width or width
    if len(row) != out.v_width:
        raise ValueError("vertices of different lengths")
    out.v.extend(row)


def _add_face(out: _Statements, words: list[str], material: int) -> None:
    """A polygon as a fan of triangles."""
    vertices, texture_vertices = len(out.v) // max(out.v_width, 3), len(out.vt) // 2
    corners = [_corner(word, vertices, texture_vertices) for word in words[1:]]
    number = out.polygons[-1] + 1 if out.polygons else 0
    for k in range(1, len(corners) - 1):
        out.corners.extend((*corners[0], *corners[k], *corners[k + 1]))
        out.polygons.append(number)
        out.face_materials.append(material)


def _cut_by_ears(path: Path, v: Float64, corners: Int64, polygon: Int64) -> None:
    """Triangulate by ears, in place, the polygons for which a fan is wrong."""
    for fan in polygons.left(v[:, :3], corners[..., 0], polygon):
        around = np.concatenate([corners[fan.start, :2], corners[fan, 2]])
        corners[fan] = around[polygons.ears(v[around[:, 0], :3], path)]


def _corner(word: str, vertices: int, texture_vertices: int) -> tuple[int, int]:
    parts = word.split("/")
    v = int(parts[0])
    t = int(parts[1]) if len(parts) > 1 and parts[1] else 0
    if v == 0:
        raise ValueError("indices count from 1")
    return (v - 1 if v > 0 else vertices + v), (t - 1 if t > 0 else texture_vertices + t if t < 0 else -1)


def _materials(
    files: MeshFiles, statements: _Statements, names: list[str], colored: bool
) -> tuple[tuple[Material, ...], list[str]]:
    """The materials of these names, and notes on them. colored: the vertices have colours, which are used
    if the material file is missing."""
    libraries = [name for line in statements.libraries for name in _libraries(files, line)]
    there = [name for name in libraries if not colored or files.has(name, _LIBRARY, files.mesh)]
    known, order, notes = read_materials(files, there, names)
    lost = [name for name in libraries if name not in there]
    if colored:
        notes = [_lost(name) for name in lost]
    if len(order) == 1 and names == [""]:  # exporters that name a library but forget `usemtl`
        return (known[order[0]],), notes
    missing = [name for name in names if name and name not in known]
    if missing and not (colored and (lost or not libraries)):
        named = ", ".join(statements.libraries) or "no mtllib"
        raise InputError(
            files.mesh,
            found=f"usemtl {missing[0]}",
            expected=f"that material in {named} (there: {', '.join(order) or 'none'})",
            fix="Put the .mtl that belongs to the mesh beside it, or export again.",
        )
    return tuple(known.get(name, Material("")) for name in names), notes


def _lost(library: str) -> str:
    return (
        f"the {_LIBRARY} {library[:80]}, which the mesh names, is missing; the colours at its vertices are "
        "used. If the mesh should have a texture, put that file and the texture beside the mesh"
    )
