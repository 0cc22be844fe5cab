"""Textured meshes as a BOP models folder: `obj_NNNNNN.obj` with `.mtl` and `.png`, millimetres."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from huepose.geometry.mesh import Mesh
from huepose.support.errors import InputError


def write_models_folder(folder: Path, meshes: Mapping[str, Mesh], object_ids: Mapping[str, int]) -> None:
    """Write meshes (metres, by name) under their ids, and `models_info.json` with their names and extents.

    Raises InputError where the folder cannot be written."""
    infos = {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, mesh in meshes.items():
            stem = f"obj_{object_ids[name]:06d}"
            write_obj(folder / f"{stem}.obj", mesh, scale=1000.0)
            low, high = 1000.0 * mesh.vertices.min(0), 1000.0 * mesh.vertices.max(0)
            sizes = {f"size_{axis}": float(s) for axis, s in zip("xyz", high - low, strict=True)}
            lows = {f"min_{axis}": float(s) for axis, s in zip("xyz", low, strict=True)}
            infos[str(object_ids[name])] = {"name": name, **lows, **sizes}
        (folder / "models_info.json").write_text(json.dumps(infos, indent=1))
    except OSError as error:
        raise InputError(
            folder, found=error.strerror or str(error), expected="a folder that can be written"
        ) from None


def write_obj(path: Path, mesh: Mesh, scale: float = 1.0) -> None:
    """Write PATH with a material file and a PNG of the same stem; lengths times `scale`. Raises OSError."""
    lines = [f"mtllib {path.stem}.mtl", "usemtl print"]
    lines += ["v {:.6f} {:.6f} {:.6f}".format(*(scale * v)) for v in mesh.vertices.astype(np.float64)]
    lines += [f"vt {u:.7f} {1.0 - v:.7f}" for u, v in mesh.uv.reshape(-1, 2).astype(np.float64)]
    lines += [
        "f " + " ".join(f"{corner + 1}/{3 * k + j + 1}" for j, corner in enumerate(face))
        for k, face in enumerate(mesh.faces)
    ]
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".mtl").write_text(f"newmtl print\nKd 1 1 1\nmap_Kd {path.stem}.png\n")
    ok, data = cv2.imencode(".png", np.ascontiguousarray(mesh.texture[..., ::-1]))
    assert ok
    path.with_suffix(".png").write_bytes(data.tobytes())
