"""YCB_Video_Dataset, the raw layout of YCB-Video, filled with the drawn frames of a stand-in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from scipy.io import savemat

from huepose.datasets.bop import BopScene
from huepose.datasets.bop_writer import write_obj
from huepose.datasets.types import Sample
from huepose.datasets.ycb_objects import T_posecnn_obj
from huepose.geometry import Mesh, se3
from huepose.scenes.official_sets import SetObject, write_bop_ycbv

_FACTOR_DEPTH = 10000


def write_ycbv_raw(out: Path, objects: Sequence[SetObject], scenes: int, frames: int, seed: int) -> None:
    """YCB_Video_Dataset: `data/NNNN/`, `image_sets/`, `models/NAME/textured.obj`. Raises InputError."""
    by_id = {o.object_id: o for o in objects}
    keyframes = []
    with TemporaryDirectory() as drawn:
        write_bop_ycbv(Path(drawn), objects, scenes, frames, seed)
        for folder in sorted((Path(drawn) / "test").iterdir()):
            reader = BopScene(folder)
            for image in reader.image_ids:
                name = f"{int(folder.name):04d}/{image + 1:06d}"
                _write_raw(out / "data" / name, Sample.of(reader, image), by_id)
                keyframes.append(name)
    sets = out / "image_sets"
    sets.mkdir(parents=True, exist_ok=True)
    (sets / "keyframe.txt").write_text("\n".join(keyframes) + "\n")
    last = max(by_id)
    names = [by_id[i].name if i in by_id else f"none_{i:03d}" for i in range(1, last + 1)]
    (sets / "classes.txt").write_text("\n".join(names) + "\n")
    for obj in objects:
        folder = out / "models" / obj.name
        folder.mkdir(parents=True, exist_ok=True)
        moved = (obj.mesh.vertices - obj.offset_m).astype(np.float32)
        write_obj(folder / "textured.obj", Mesh(moved, obj.mesh.faces, obj.mesh.uv, obj.mesh.texture))


def _write_raw(stem: Path, sample: Sample, by_id: Mapping[int, SetObject]) -> None:
    """One frame; of the objects that show at all."""
    labels = np.zeros(sample.frame.depth.shape, np.uint8)
    ids, poses, boxes = [], [], []
    for truth in sample.truths:
        mask = truth.mask()
        if mask is None or not mask.any() or truth.T_cam_obj is None or truth.object_id is None:
            continue
        obj = by_id[truth.object_id]
        labels[mask] = truth.object_id
        ids.append(truth.object_id)
        poses.append(se3.compose(truth.T_cam_obj, se3.inverse(T_posecnn_obj(obj.offset_m)))[:3])
        rows, columns = np.nonzero(mask)
        boxes.append(f"{obj.name} {columns.min()} {rows.min()} {columns.max()} {rows.max()}")
    depth = np.rint(sample.frame.depth * _FACTOR_DEPTH).astype(np.uint16)
    _picture(stem.with_name(f"{stem.name}-color.png"), sample.frame.color[..., ::-1])
    _picture(stem.with_name(f"{stem.name}-depth.png"), depth)
    _picture(stem.with_name(f"{stem.name}-label.png"), labels)
    stem.with_name(f"{stem.name}-box.txt").write_text("\n".join(boxes) + "\n")
    meta = {
        "cls_indexes": np.array(ids, np.uint8)[:, None],
        "factor_depth": np.array([[_FACTOR_DEPTH]], np.uint16),
        "intrinsic_matrix": sample.frame.camera.K,
        "poses": np.stack(poses, -1) if poses else np.empty((3, 4, 0)),
    }
    savemat(stem.with_name(f"{stem.name}-meta.mat"), meta)


def _picture(path: Path, picture: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(picture))[1].tobytes())
