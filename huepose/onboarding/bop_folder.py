"""A BOP models folder as a list of objects to onboard: meshes, names, symmetries, frame offsets."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from huepose.datasets import files
from huepose.datasets.ycb_objects import YcbObject, is_ycbv, ycb_objects
from huepose.geometry.arrays import Float64
from huepose.onboarding.declared import check_symmetries
from huepose.support.errors import InputError

_NUMBERED = re.compile(r"obj_(\d+)\.(ply|obj)")


@dataclass(frozen=True, eq=False)
class BopModel:
    """mesh_path: a mesh in millimetres; info: the object's entry of models_info.json; frame_offset_m (3,):
    transforms points of the PoseCNN/YCB-Video frame to the mesh's frame, or None."""

    object_id: int
    name: str
    mesh_path: Path
    info: Mapping[str, Any]
    frame_offset_m: Float64 | None


def bop_models(folder: Path | str, ids: Collection[int] | None = None) -> list[BopModel]:
    """The objects `obj_NNNNNN.ply` or `.obj` of a folder, by id; `ids`: only these.

    Names come from frame_offsets.json, or else from models_info.json. BOP's own download has no names;
    YCB-V is recognised there by its diameters. Other objects are named `obj_NNNNNN`. Raises InputError for
    a folder without meshes, a missing id, a broken file, and names that are not unique.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(folder, found="no such folder", expected="a BOP models folder")
    meshes: dict[int, Path] = {}
    for suffix in (".ply", ".obj"):  # if there are both, the OBJ is used: it has a texture
        for path in sorted(folder.glob(f"obj_*{suffix}")):
            if number := _NUMBERED.fullmatch(path.name):
                meshes[int(number[1])] = path
    if not meshes:
        raise InputError(
            folder,
            found="no obj_NNNNNN.ply or .obj",
            expected="a BOP models folder",
            fix="For a single mesh use `huepose onboard MESH --name NAME`.",
        )
    infos = _read(folder / "models_info.json")
    offsets = _read(folder / "frame_offsets.json")
    missing = sorted(set(ids or ()) - meshes.keys())
    if missing:
        raise InputError(
            folder,
            found=f"no mesh of object {missing[0]}",
            expected=f"one of {', '.join(str(i) for i in sorted(meshes))}",
            fix="Choose one of these, or put its mesh there.",
        )
    out = [_entry(i, meshes[i], folder, infos, offsets) for i in sorted(meshes) if not ids or i in ids]
    if is_ycbv({m.object_id: float(m.info["diameter"]) for m in out if "diameter" in m.info}):
        out = [_as_ycb(m, ycb_objects().get(m.object_id)) for m in out]
    names = [m.name for m in out]
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice:
        raise InputError(folder, found=f"two objects named {twice}", expected="unique names")
    return out


def other_meshes(folder: Path) -> list[str]:
    """The mesh files of a folder that `bop_models` does not take, because of their names."""
    meshes = (
        path.name for path in folder.iterdir() if path.suffix.lower() in (".ply", ".obj", ".glb", ".gltf")
    )
    return sorted(name for name in meshes if not _NUMBERED.fullmatch(name))


def safe_name(text: str) -> str:
    """A name of [a-z0-9_-]{1,64} from any text, '' if nothing is left.

    >>> safe_name("Mustard Bottle (006)")
    'mustard_bottle_006'
    """
    return re.sub(r"[^a-z0-9_-]+", "_", text.lower()).strip("_")[:64]


def _entry(
    i: int, path: Path, folder: Path, infos: Mapping[str, Any], offsets: Mapping[str, Any]
) -> BopModel:
    info = infos.get(str(i), {})
    where = f"{folder / 'models_info.json'} object {i}"
    if not isinstance(info, dict):
        raise InputError(where, found=str(info)[:80], expected="an object with its diameter")
    if "diameter" in info:
        files.positive(info, "diameter", where)
    check_symmetries(info, where)
    key = next((k for k, v in offsets.items() if isinstance(v, dict) and v.get("bop_obj_id") == i), None)
    offset = None
    if key is not None and "posecnn_to_bop_t_mm" in offsets[key]:
        where = f"{folder / 'frame_offsets.json'} {key}"
        offset = files.numbers(offsets[key], "posecnn_to_bop_t_mm", (3,), where) / 1000.0
    name = safe_name(key or "") or safe_name(str(info.get("name", ""))) or f"obj_{i:06d}"
    return BopModel(i, name, path, info, offset)


def _as_ycb(model: BopModel, known: YcbObject | None) -> BopModel:
    """The model with the known name and offset of the YCB object, if the folder does not state them."""
    if known is None:
        return model
    unnamed = model.name == f"obj_{model.object_id:06d}"
    offset = known.frame_offset_m if model.frame_offset_m is None else model.frame_offset_m
    return replace(model, name=known.name if unnamed else model.name, frame_offset_m=offset)


def _read(path: Path) -> dict[str, Any]:
    return files.read_json(path) if path.exists() else {}
