"""Recognises files that cannot be read as a mesh, by their ending or first bytes, and says what to do."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from huepose.support.errors import InputError

_COLOURLESS = (
    "It holds no texture, and HuePose needs one: give the mesh a texture in a modelling program, and export "
    "it as GLB."
)
_EXPORT = "Open it in its program, and export it as GLB with its texture."
_LONGEST = 256
"""Number of first bytes of a file that show its kind."""

_GIT_LFS = b"version https://git-lfs"
_WEB_PAGE = (b"<!doctype html", b"<html", b"<head", b"<script")


@dataclass(frozen=True)
class _Kind:
    name: str
    endings: tuple[str, ...]
    starts: tuple[bytes, ...]
    fix: str


_KINDS = (
    _Kind("an STL mesh", (".stl",), (b"solid ",), _COLOURLESS),
    _Kind("a STEP file", (".step", ".stp"), (b"ISO-10303",), _COLOURLESS),
    _Kind("a Blender file", (".blend",), (b"BLENDER",), _EXPORT),
    _Kind("an FBX file", (".fbx",), (b"Kaydara",), _EXPORT),
    _Kind("a COLLADA file", (".dae",), (), _EXPORT),
    _Kind(
        "an image",
        (".png", ".jpg", ".jpeg"),
        (b"\x89PNG", b"\xff\xd8\xff"),
        "Give the mesh that it belongs to: the mesh names its texture.",
    ),
    _Kind("a material file", (".mtl",), (), "Give the .obj that names it: it reads this file by itself."),
    _Kind("a zip archive", (".zip",), (b"PK\x03\x04",), "Unpack it, and give the mesh in it."),
)


def check_kind(path: Path, readable: Collection[str]) -> None:
    """Raises InputError for a file of another kind than those with the endings `readable`, even if it has
    such an ending."""
    ending = path.suffix.lower()
    start = _start(path)
    check_fetched(start, path, "the mesh")
    kind = next((k for k in _KINDS if ending in k.endings or start.startswith(k.starts)), None)
    if kind is None and ending in readable:
        return
    if kind is None:
        found = f"a file of type '{path.suffix}'" if ending else "a file without an ending"
        fix = "Export the mesh as GLB with its texture."
    else:
        found, fix = kind.name, kind.fix
        if ending not in kind.endings:
            found += f" by its first bytes, with the ending '{path.suffix}'"
    raise InputError(path, found=found, expected=", ".join(readable), fix=fix)


def check_fetched(data: bytes, path: Path, expected: str) -> None:
    """Raises InputError for a file from a failed download, such as a web page. data: at least its first
    bytes."""
    if data.startswith(_GIT_LFS):
        raise InputError(path, found="a Git LFS pointer", expected=expected, fix="Fetch it: git lfs pull.")
    if data[:_LONGEST].removeprefix(b"\xef\xbb\xbf").lstrip().lower().startswith(_WEB_PAGE):
        fix = "The download failed: open the link in a browser, and save the file itself."
        raise InputError(path, found="a web page (HTML)", expected=expected, fix=fix)


def _start(path: Path) -> bytes:
    """The first bytes of a file; none if it cannot be read, which its reader will report."""
    if not path.is_file():
        return b""
    try:
        with path.open("rb") as file:
            return file.read(_LONGEST)
    except OSError:
        return b""
