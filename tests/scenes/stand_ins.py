"""Small stand-ins for YCB-Video and Fast-YCB: even light and little occlusion."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from huepose.scenes.official_sets import SetObject, write_bop_ycbv, write_fast_ycb_set
from huepose.scenes.rendered import SceneRanges
from tests.meshes import demo_objects

APART_M = np.array([0.003, -0.002, 0.008])
"""Offset between the model frames of BOP and PoseCNN, times the id; the real offsets are of this size."""

EASY = SceneRanges(
    objects=(4, 6),
    others=(0, 1),
    spread_m=(0.28, 0.34),
    distance_m=(0.55, 0.75),
    exposure=(-0.3, 0.3),
    tint=(-0.05, 0.05),
    key=(0.5, 0.7),
    sky=(0.3, 0.4),
    gloss=(0.0, 0.1),
    shake_px=(0.5, 1.0),
)
HALF_TURN = {"symmetries_discrete": [[-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]]}


def stand_in_objects(count: int) -> list[SetObject]:
    """The first `count` demo objects, with ids from 1."""
    named = list(demo_objects(0).items())[:count]
    return [SetObject(i, name, mesh, i * APART_M, HALF_TURN) for i, (name, mesh) in enumerate(named, 1)]


def write_stand_ins(
    root: Path, objects: list[SetObject], images: int, sequences: int, frames: int, seed: int
) -> None:
    """`root/ycbv` with one scene, and `root/fast`, whose DOPE poses lack the second frame."""
    write_bop_ycbv(root / "ycbv", objects, 1, images, seed, EASY)
    write_fast_ycb_set(root / "fast", objects, sequences, frames, seed)
    for folder in (root / "fast").iterdir():
        rows = (folder / "gt" / "poses_ycb.txt").read_text().splitlines()
        rows[1] = "0 0 0 0 0 0 0"
        (folder / "dope").mkdir()
        (folder / "dope" / "poses_ycb.txt").write_text("\n".join(rows) + "\n")
