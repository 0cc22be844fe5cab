"""Rendered data in the layouts of YCB-Video and Fast-YCB, of any meshes, and of the unseen objects at one
seed.

Single frames show heaps in varied light, with depth as of a stereo camera. Sequences show moving objects,
with exact depth. The readers of the official downloads read these, too, and their ground truth is exact.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from huepose.datasets.bop import BopScene
from huepose.datasets.bop_writer import extents_mm, write_bare_ply, write_ply
from huepose.datasets.fast_ycb import FastYcbFrame, write_fast_ycb
from huepose.datasets.types import GONE
from huepose.geometry import Mesh
from huepose.geometry.arrays import Float64
from huepose.scenes import carried
from huepose.scenes.camera import COLOR, RATE_HZ
from huepose.scenes.frame import Shot, shoot
from huepose.scenes.rendered import SceneRanges, write_rendered_set
from huepose.scenes.unseen.objects import unseen_objects
from huepose.support.files import write_text
from huepose.support.progress import progress

FIRST_SCENE = 48
"""Number of the first test scene of YCB-Video."""

FIRST_ID = 101
"""First id of the unseen objects: above the ids of YCB-Video."""

SCENES, FRAMES = 8, 5
SEQUENCES, SEQUENCE_FRAMES = 24, 30
"""Of the unseen objects: heaps in the layout of YCB-Video, and sequences in that of Fast-YCB."""

SEED = 0
"""Seed of the unseen objects and of their frames."""


@dataclass(frozen=True, eq=False)
class SetObject:
    """mesh: in metres, in BOP's model frame; offset_m (3,): added to points of the PoseCNN frame gives points
    of BOP's; info: further entries of models_info.json (symmetries)."""

    object_id: int
    name: str
    mesh: Mesh
    offset_m: Float64
    info: Mapping[str, Any]


def write_bop_ycbv(
    out: Path, objects: Sequence[SetObject], scenes: int, frames: int, seed: int, ranges: SceneRanges
) -> None:
    """Write the layout of BOP's download: `test/NNNNNN/` without `mask/`, `test_targets_bop19.json`,
    `models/`, `models_eval/`. Incomplete scenes are continued. Raises InputError."""
    meshes, ids = {o.name: o.mesh for o in objects}, {o.name: o.object_id for o in objects}
    targets = []
    for scene in range(FIRST_SCENE, FIRST_SCENE + scenes):
        folder = out / "test" / f"{scene:06d}"
        write_rendered_set(folder, meshes, ids, frames, seed * 1000 + scene, ranges, ".png")
        reader = BopScene(folder)
        targets += [
            {"im_id": image, "inst_count": 1, "obj_id": truth.object_id, "scene_id": scene}
            for image in reader.image_ids
            for truth in reader.truths(image)
            if truth.shows(GONE)
        ]
    write_text(out / "test_targets_bop19.json", json.dumps(targets))
    _write_models(out, objects)


def _write_models(out: Path, objects: Sequence[SetObject]) -> None:
    infos, offsets = {}, {}
    for obj in objects:
        name = f"obj_{obj.object_id:06d}.ply"
        write_ply(out / "models" / name, obj.mesh)
        write_bare_ply(out / "models_eval" / name, obj.mesh)
        points = 1000.0 * obj.mesh.vertices.astype(np.float64)
        infos[str(obj.object_id)] = {
            "diameter": float(pdist(points[ConvexHull(points).vertices]).max()),
            **extents_mm(obj.mesh),
            **obj.info,
            "name": obj.name,
        }
        offset_mm = (1000.0 * obj.offset_m).tolist()
        offsets[obj.name] = {"bop_obj_id": obj.object_id, "posecnn_to_bop_t_mm": offset_mm}
    for folder in ("models", "models_eval"):
        write_text(out / folder / "models_info.json", json.dumps(infos, indent=1))
    write_text(out / "models" / "frame_offsets.json", json.dumps(offsets, indent=1))


def _frame(shot: Shot) -> FastYcbFrame:
    """The images of a frame, with the mask and the pose of the first object."""
    return FastYcbFrame(shot.color, shot.depth, shot.owner == 0, shot.labels.T_cam_obj[0])


def write_fast_ycb_set(
    out: Path, objects: Sequence[SetObject], sequences: int, frames: int, seed: int
) -> None:
    """Write the layout of Fast-YCB: one sequence for each of the first `sequences` objects. Complete
    sequences that are already there are kept."""
    wanted = list(enumerate(objects[:sequences]))
    missing = [(k, obj) for k, obj in wanted if not (out / obj.name / "gt" / "poses_ycb.txt").exists()]
    for number, obj in progress(missing, "rendering sequences") if missing else ():
        folder = out / obj.name
        rng = np.random.default_rng([seed, number, 67])
        stage = carried.staged(obj.mesh, [o.mesh for o in objects if o is not obj], rng)
        n = min(frames, carried.FRAMES)
        shots = (shoot(stage, i, seed * 1000 + number, COLOR, None) for i in range(n))
        frames_of = map(_frame, shots)
        write_fast_ycb(folder, obj.name, frames_of, stage.camera, RATE_HZ, obj.offset_m)


def unseen_set() -> list[SetObject]:
    """The unseen objects with their ids; `texture` in models_info.json marks those with little texture."""
    return [
        SetObject(number, obj.name, obj.mesh, np.zeros(3), {"texture": "little"} if obj.plain else {})
        for number, obj in enumerate(unseen_objects(SEED), FIRST_ID)
    ]


def write_unseen(out: Path, scenes: int = SCENES, frames: int = FRAMES, sequences: int = SEQUENCES) -> None:
    """Write `out/ycbv` in BOP's layout, with the meshes, and `out/fast` in that of Fast-YCB. Frames and
    sequences that are already there are kept. Raises InputError."""
    objects = unseen_set()
    write_bop_ycbv(out / "ycbv", objects, scenes, frames, SEED, SceneRanges())
    write_fast_ycb_set(out / "fast", objects, sequences, SEQUENCE_FRAMES, SEED)
