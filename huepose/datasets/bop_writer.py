"""Writes scenes and models folders in the layout of the BOP benchmark.

A scene is written frame by frame: writing can be stopped and continued.

It has the files that `datasets.bop` reads: `rgb/` (JPEG, or PNG if requested), `depth/` (16 bit, tenths of a
millimetre), `mask_visib/`, `scene_camera.json`, `scene_gt.json`, `scene_gt_info.json`; and `rendered.json`
with the settings of the scene. The JSON files are rewritten after each frame and have only frames whose
images are complete.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.datasets import files
from huepose.geometry import Box, Camera
from huepose.geometry.arrays import Bool, Float32, Float64, Int32, Int64, UInt8, UInt16
from huepose.geometry.camera import whole_steps
from huepose.geometry.mesh import Mesh
from huepose.support.errors import InputError
from huepose.support.files import whole, write_bytes, write_text, writing

DEPTH_SCALE_MM = 0.1
"""Step of the depth images: 16 bits reach 6.5 m."""

JPEG_QUALITY = 95
_SHEETS = ("scene_camera", "scene_gt", "scene_gt_info")


@dataclass(frozen=True, eq=False)
class Label:
    """One labelled object of a frame: object_id; T_cam_obj (4, 4) m; mask (H, W): its visible pixels;
    silhouette_px, silhouette: pixel count and bounds of its outline as if nothing occluded it, parts outside
    the image included."""

    object_id: int
    T_cam_obj: Float64
    mask: Bool
    silhouette_px: int
    silhouette: Box


class BopWriter:
    """Writes one scene folder. facts: the settings that its frames are made from; a folder with other facts
    is refused; color_suffix: `.jpg` or `.png`."""

    def __init__(self, folder: Path, facts: dict[str, Any], color_suffix: str = ".jpg") -> None:
        """Open or make the folder. Raises InputError if it holds something else or cannot be written."""
        self.folder, self._color_suffix = folder, color_suffix
        self._sheets: dict[str, dict[str, Any]] = {name: {} for name in _SHEETS}
        facts_path = folder / "rendered.json"
        if facts_path.exists():
            stored = files.read_json(facts_path)
            if stored != json.loads(json.dumps(facts)):
                raise InputError(
                    folder,
                    found="a scene that was rendered with other settings",
                    expected="an empty folder, or a scene with the same settings to continue",
                    fix="Choose another --out, or remove that folder.",
                )
            for name in _SHEETS:
                path = folder / f"{name}.json"
                self._sheets[name] = files.read_json(path) if path.exists() else {}
        elif folder.is_dir() and any(folder.iterdir()):
            raise InputError(
                folder,
                found="a folder with other files in it",
                expected="a new or empty folder",
                fix="Choose another --out.",
            )
        with writing(folder):
            for part in ("rgb", "depth", "mask_visib"):
                (folder / part).mkdir(parents=True, exist_ok=True)
            _write(facts_path, json.dumps(facts, indent=1).encode())

    @property
    def done(self) -> frozenset[int]:
        """Numbers of the complete frames in the folder."""
        cameras, labels, details = (set(self._sheets[name]) for name in _SHEETS)
        return frozenset(int(key) for key in cameras & labels & details)

    def add(self, image: int, color: UInt8, depth: Float32, camera: Camera, labels: Sequence[Label]) -> None:
        """Write a frame: color (H, W, 3) uint8 RGB, depth (H, W) float32 m. Raises InputError."""
        stem, key = f"{image:06d}", str(image)
        suffix = self._color_suffix
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if suffix == ".jpg" else []
        with writing(self.folder, "a folder with room for about 0.6 MB per frame"):
            _write(self.folder / "rgb" / f"{stem}{suffix}", _encoded(suffix, color[..., ::-1], quality))
            _write(self.folder / "depth" / f"{stem}.png", _encoded(".png", depth_steps(depth)))
            for k, label in enumerate(labels):
                picture = label.mask.astype(np.uint8) * np.uint8(255)
                _write(self.folder / "mask_visib" / f"{stem}_{k:06d}.png", _encoded(".png", picture))
            self._sheets["scene_camera"][key] = {
                "cam_K": camera.K.reshape(-1).tolist(),
                "depth_scale": DEPTH_SCALE_MM,
            }
            self._sheets["scene_gt"][key] = [_pose(label) for label in labels]
            self._sheets["scene_gt_info"][key] = [_details(label) for label in labels]
            for name, sheet in self._sheets.items():
                _write(self.folder / f"{name}.json", json.dumps(sheet).encode())


def depth_steps(depth: Float32) -> UInt16:
    """Depth (H, W), metres, in steps of DEPTH_SCALE_MM; 0 (no depth) where it is too far for 16 bits."""
    return whole_steps(depth * np.float32(1000.0 / DEPTH_SCALE_MM))


def _pose(label: Label) -> dict[str, Any]:
    return {
        "cam_R_m2c": label.T_cam_obj[:3, :3].reshape(-1).tolist(),
        "cam_t_m2c": (1000.0 * label.T_cam_obj[:3, 3]).tolist(),
        "obj_id": label.object_id,
    }


def _details(label: Label) -> dict[str, Any]:
    seen, box = int(label.mask.sum()), Box.of_mask(label.mask)
    return {
        "bbox_obj": [round(v) for v in label.silhouette],
        "bbox_visib": [-1, -1, -1, -1] if box is None else [round(v) for v in box],
        "px_count_all": label.silhouette_px,
        "px_count_visib": seen,
        "visib_fract": seen / label.silhouette_px if label.silhouette_px else 0.0,
    }


def _encoded(kind: str, picture: np.ndarray, parameters: Sequence[int] = ()) -> bytes:
    ok, data = cv2.imencode(kind, np.ascontiguousarray(picture), list(parameters))
    assert ok
    return bytes(data.tobytes())


def _write(path: Path, data: bytes) -> None:
    with whole(path) as part:
        part.write_bytes(data)


def write_models_folder(folder: Path, meshes: Mapping[str, Mesh], object_ids: Mapping[str, int]) -> None:
    """Write meshes (metres, by name) under their ids, and `models_info.json` with their names and extents.

    Raises InputError if the folder cannot be written."""
    infos = {}
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, mesh in meshes.items():
            stem = f"obj_{object_ids[name]:06d}"
            write_obj(folder / f"{stem}.obj", mesh, scale=1000.0)
            infos[str(object_ids[name])] = {"name": name, **extents_mm(mesh)}
        (folder / "models_info.json").write_text(json.dumps(infos, indent=1))


def extents_mm(mesh: Mesh) -> dict[str, float]:
    """`min_x`, ..., `size_x`, ... for models_info.json."""
    points = 1000.0 * mesh.vertices.astype(np.float64)
    parts = {"min": points.min(0), "size": np.ptp(points, axis=0)}
    return {
        f"{part}_{axis}": float(v) for part, row in parts.items() for axis, v in zip("xyz", row, strict=True)
    }


def write_ply(path: Path, mesh: Mesh) -> None:
    """Write PATH in the form of BOP's models, in millimetres, with a PNG of the same stem. In this form
    texture coordinates belong to vertices, so every corner of a face is a vertex. Raises InputError."""
    corners = 1000.0 * mesh.vertices[mesh.faces].reshape(-1, 3).astype(np.float64)
    uv = mesh.uv.reshape(-1, 2).astype(np.float64) * [1.0, -1.0] + [0.0, 1.0]
    faces = np.arange(len(corners)).reshape(-1, 3)
    names = ("x", "y", "z", "texture_u", "texture_v")
    _write_ascii(path, (f"comment TextureFile {path.stem}.png",), names, np.hstack([corners, uv]), faces)
    write_bytes(path.with_suffix(".png"), _encoded(".png", mesh.texture[..., ::-1]))


def write_bare_ply(path: Path, mesh: Mesh) -> None:
    """Write PATH in the form of BOP's `models_eval/`, in millimetres: vertices and faces, no colours. Raises
    InputError."""
    _write_ascii(path, (), ("x", "y", "z"), 1000.0 * mesh.vertices.astype(np.float64), mesh.faces)


def _write_ascii(
    path: Path,
    comments: Sequence[str],
    names: Sequence[str],
    vertices: Float64,
    faces: Int32 | Int64,
) -> None:
    """A PLY of vertices (V, P), one column for each name, and faces (F, 3)."""
    header = ["ply", "format ascii 1.0", *comments, f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(f"{v:.7g}" for v in row) for row in vertices]
    corners = [f"3 {a} {b} {c}" for a, b, c in faces]
    write_text(path, "\n".join([*header, *rows, *corners]) + "\n")


def write_obj(path: Path, mesh: Mesh, scale: float = 1.0) -> None:
    """Write PATH with a material file and a PNG of the same stem; lengths times `scale`. Raises
    InputError."""
    lines = [f"mtllib {path.stem}.mtl", "usemtl print"]
    lines += ["v {:.6f} {:.6f} {:.6f}".format(*(scale * v)) for v in mesh.vertices.astype(np.float64)]
    lines += [f"vt {u:.7f} {1.0 - v:.7f}" for u, v in mesh.uv.reshape(-1, 2).astype(np.float64)]
    lines += [
        "f " + " ".join(f"{corner + 1}/{3 * k + j + 1}" for j, corner in enumerate(face))
        for k, face in enumerate(mesh.faces)
    ]
    write_text(path, "\n".join(lines) + "\n")
    write_text(path.with_suffix(".mtl"), f"newmtl print\nKd 1 1 1\nmap_Kd {path.stem}.png\n")
    write_bytes(path.with_suffix(".png"), _encoded(".png", mesh.texture[..., ::-1]))
