"""Materials of Wavefront OBJ files: the colour `Kd` and the texture `map_Kd`."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from huepose.onboarding.mesh_files import MeshFiles, decoded
from huepose.onboarding.raw_mesh import RE_EXPORT, Material
from huepose.support.errors import InputError

_MAP_OPTION_ARGUMENTS = {"-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1}
_MAP_OPTION_ARGUMENTS |= {"-imfchan": 1, "-mm": 2, "-texres": 1, "-type": 1}
_GREY = (200, 200, 200)


def read_materials(
    files: MeshFiles, libraries: Sequence[str], wanted: Collection[str]
) -> tuple[dict[str, Material], list[str]]:
    """Materials by name that an OBJ file's libraries have of those `wanted`, and the names of all they have.

    A material that nobody wants costs nothing: its texture is not read. A single material is read always.
    Raises InputError naming the file, what was found and what to do.
    """
    colors: dict[str, tuple[int, int, int]] = {}
    maps: dict[str, tuple[Path, str]] = {}
    for library in libraries:
        path, data = files.read(library, "material file", files.mesh)
        in_library, maps_in_library = _parsed(path, decoded(data))
        for name, color in in_library.items():
            colors[name] = color
            maps.pop(name, None)
        maps |= {name: (path, line) for name, line in maps_in_library.items()}
    materials = {}
    for name, color in colors.items():
        if name in wanted or len(colors) == 1:
            texture = None
            if name in maps:
                path, line = maps[name]
                texture = files.texture(_map_file(path, line), path)
            materials[name] = Material(name, color, texture)
    return materials, list(colors)


def _parsed(mtl: Path, text: str) -> tuple[dict[str, tuple[int, int, int]], dict[str, str]]:
    """Colours, and lines `map_Kd`, by the name of their material."""
    colors: dict[str, tuple[int, int, int]] = {}
    maps: dict[str, str] = {}
    name = ""
    for line in text.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "newmtl":
            name = line.split(None, 1)[1].strip() if len(words) > 1 else ""
            colors[name] = _GREY
        elif words[0] == "Kd" and len(words) >= 4:
            try:
                r, g, b = (min(255, max(0, round(255 * float(w)))) for w in words[1:4])
            except (ValueError, OverflowError):
                found = line.strip()[:60]
                raise InputError(mtl, found=found, expected="Kd r g b with numbers 0..1") from None
            colors[name] = (r, g, b)
        elif words[0] == "map_Kd" and len(words) > 1:
            maps[name] = line
    return colors, maps


def _map_file(mtl: Path, line: str) -> str:
    """File name of a `map_Kd` line: options are skipped, spaces in the name are kept."""
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
        rest = rest.split(None, 1 + count)[-1]
    return rest


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
