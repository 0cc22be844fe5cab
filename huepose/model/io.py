"""Reference models on disk: `BUNDLES/<name>.huepose`, a zip of plain arrays that loads in milliseconds."""

from __future__ import annotations

import io
import json
import re
import shlex
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.geometry.arrays import UInt8
from huepose.geometry.mesh import Mesh
from huepose.model.archive import Archive, aligned_entry, texture_of
from huepose.model.plausible import check_model
from huepose.model.types import (
    DistanceGrid,
    Keypoints,
    PairReference,
    PaperTables,
    ReferenceModel,
    Surface,
    ViewTemplates,
)
from huepose.support.errors import InputError
from huepose.support.files import whole
from huepose.support.kept import kept
from huepose.support.words import did_you_mean

SUFFIX = ".huepose"
VERSION = 2

_FORMAT = "huepose reference model"
_MAKE = "Onboard the object again with `huepose onboard` or `huepose onboard-bop`"
_AGAIN = f"{_MAKE}, or take the file out of the folder."


@dataclass(frozen=True, eq=False)
class _Texture:
    """rgb (H, W, 3) uint8, decoded."""

    rgb: UInt8


_EPOCH = (1980, 1, 1, 0, 0, 0)  # no clock in the file: the same model gives the same bytes


def check_name(name: str) -> str:
    """The name itself. Raises InputError unless it is of [a-z0-9_-]{1,64}."""
    if not re.fullmatch(r"[a-z0-9_-]{1,64}", name):
        raise InputError(
            f"object name '{name}'", expected="1 to 64 of a-z, 0-9, _ and -", fix="Give another name."
        )
    return name


def model_path(bundles_dir: Path | str, name: str) -> Path:
    """The path of the reference model of that name."""
    return Path(bundles_dir) / f"{name}{SUFFIX}"


def model_names(bundles_dir: Path | str) -> list[str]:
    """The names of the reference models in a folder, in alphabetical order, from the file names alone."""
    files = Path(bundles_dir).glob(f"*{SUFFIX}")
    return sorted(p.name[: -len(SUFFIX)] for p in files if not p.name.startswith("."))


def save_model(model: ReferenceModel, path: Path | str) -> None:
    """Write a reference model. The file appears complete or not at all. Equal models give equal bytes."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    ok, png = cv2.imencode(".png", model.mesh.texture[..., ::-1])
    if not ok:
        raise InputError(path, found="a texture that cannot be encoded", fix="Is the texture empty?")
    header = {
        "format": _FORMAT,
        "version": VERSION,
        "name": check_name(model.name),
        "object_id": model.object_id,
        "diameter_m": model.diameter_m,
        "grid_step": model.grid.step,
        "template_span": model.templates.span,
        "pair_parameters": model.pairs.parameters,
        "table_parameters": None if model.tables is None else model.tables.parameters,
        "keypoint_source": model.keypoints.source,
    }
    arrays: dict[str, Any] = {
        "mesh.vertices": model.mesh.vertices,
        "mesh.faces": model.mesh.faces,
        "mesh.uv": model.mesh.uv,
        "mesh.texture_png": np.asarray(png, np.uint8).reshape(-1),
        "eval_points": model.eval_points,
        "symmetries": model.symmetries,
        "turns": model.near_symmetries,
        "equivalents": model.equivalents,
        "grid.origin": model.grid.origin,
        "grid.nearest": model.grid.nearest,
    }
    if model.frame_offset_m is not None:
        arrays["frame_offset_m"] = model.frame_offset_m
    for section in ("surface", "templates", "pairs", "tables", "keypoints"):
        part = getattr(model, section)
        for name in _array_fields(type(part)) if part is not None else ():
            arrays[f"{section}.{name}"] = getattr(part, name)
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    header["types"] = {name: array.dtype.str for name, array in arrays.items()}
    with whole(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(zipfile.ZipInfo("header.json", _EPOCH), json.dumps(header, sort_keys=True))
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, _narrowed(name, array), allow_pickle=False)
            entry = aligned_entry(f"{name}.npy", archive.start_dir, _EPOCH)
            archive.writestr(entry, content.getbuffer())


def load_model(path: Path | str) -> ReferenceModel:
    """Read a reference model. Raises InputError for a missing, damaged or foreign file and for another
    version of the format."""
    path = Path(path)
    try:
        with Archive(path) as archive:
            header = archive.header()
            if header.get("format") != _FORMAT or header.get("version") != VERSION:
                raise InputError(
                    path,
                    found=f"{str(header.get('format'))[:80]} of version {str(header.get('version'))[:20]}",
                    expected=f"{_FORMAT} of version {VERSION}",
                    fix=_AGAIN,
                )
            arrays = {name: archive.array(name, kind) for name, kind in header["types"].items()}
            model = _assembled(header, arrays, archive.digest())
            check_model(model)
        return model
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(path, found="no such file", expected="a reference model", fix=f"{_MAKE}.") from None
    except Exception as error:
        # A damaged file may fail anywhere in zip, JSON, NumPy and OpenCV, each with its own errors.
        found = f"a damaged or foreign file ({type(error).__name__}: {str(error)[:200]})"
        raise InputError(path, found=found, expected="a reference model", fix=_AGAIN) from None


def load_models(bundles_dir: Path | str, names: Iterable[str] | None = None) -> dict[str, ReferenceModel]:
    """Reference models of a folder by name: all of them in alphabetical order, or the named ones.

    Raises InputError for a folder without models, for an unknown name (listing the known ones), and for a
    file that was renamed.
    """
    folder = Path(bundles_dir)
    known = model_names(folder)
    if not known:
        raise _no_models(folder)
    wanted = known if names is None else list(dict.fromkeys(names))
    unknown = [n for n in wanted if n not in known]
    if unknown:
        raise InputError(
            f"object '{unknown[0]}'",
            found=f"no such reference model in {folder}",
            expected=f"one of {', '.join(known)}",
            fix=did_you_mean(unknown[0], known) or "Correct the name, or onboard the object.",
        )
    return {name: _named(model_path(folder, name), name) for name in wanted}


def _named(path: Path, name: str) -> ReferenceModel:
    """The model in a file. Raises InputError if the model's own name, which is used everywhere else, is
    another one."""
    model = load_model(path)
    if model.name != name:
        raise InputError(
            path,
            found=f"the model '{model.name}'",
            expected=f"the model '{name}', as the file is named",
            fix=f"Rename the file to {model.name}{SUFFIX}, or onboard the object under the new name.",
        )
    return model


def _no_models(folder: Path) -> InputError:
    """The error for a folder without reference models, with a suggestion."""
    found = "no reference models" if folder.is_dir() else "no such folder"
    fix = f"Make them: huepose onboard MESH --name NAME --out {shlex.quote(str(folder))}."
    if folder.is_file():
        found, fix = "a file", f"Give its folder: {folder.parent}."
    elif below := sorted(path.parent for path in folder.glob(f"*/*{SUFFIX}")):
        fix = f"Did you mean {below[0]}?"
    return InputError(folder, found=found, expected=f"a folder of reference models, files *{SUFFIX}", fix=fix)


def _array_fields(kind: type) -> list[str]:
    return [f.name for f in fields(kind) if f.name not in ("span", "step", "parameters", "source")]


def _narrowed(name: str, array: np.ndarray) -> np.ndarray:
    """Integers of the paper's tables in the smallest type that holds them. All other arrays are stored as
    they are used, so that they can be mapped."""
    if not name.startswith("tables.") or array.dtype.kind not in "iu" or not array.size:
        return array
    return array.astype(np.promote_types(np.min_scalar_type(array.min()), np.min_scalar_type(array.max())))


def _assembled(header: dict[str, Any], arrays: dict[str, Any], digest: str) -> ReferenceModel:
    def part(section: str, kind: type) -> dict[str, Any]:
        return {name: arrays[f"{section}.{name}"] for name in _array_fields(kind)}

    tables = header["table_parameters"]
    texture = kept(_Texture, digest, lambda: _Texture(texture_of(arrays["mesh.texture_png"])))
    return ReferenceModel(
        name=check_name(header["name"]),
        object_id=header["object_id"],
        mesh=Mesh(arrays["mesh.vertices"], arrays["mesh.faces"], arrays["mesh.uv"], texture.rgb, digest),
        eval_points=arrays["eval_points"],
        diameter_m=header["diameter_m"],
        symmetries=arrays["symmetries"],
        near_symmetries=arrays["turns"],
        equivalents=arrays["equivalents"],
        frame_offset_m=arrays.get("frame_offset_m"),
        surface=Surface(**part("surface", Surface)),
        grid=DistanceGrid(arrays["grid.origin"], header["grid_step"], arrays["grid.nearest"]),
        templates=ViewTemplates(**part("templates", ViewTemplates), span=header["template_span"]),
        pairs=PairReference(**part("pairs", PairReference), parameters=header["pair_parameters"]),
        keypoints=Keypoints(**part("keypoints", Keypoints), source=header["keypoint_source"]),
        tables=None if tables is None else PaperTables(**part("tables", PaperTables), parameters=tables),
        digest=digest,
    )
