"""Frames of the unseen objects in the layouts of the official data sets, at one seed: heaps in any light with
stereo-like depth for single frames, carried objects with exact depth for tracks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from huepose.scenes.official_sets import SetObject, write_bop_ycbv, write_fast_ycb_set
from huepose.scenes.rendered import SceneRanges
from huepose.scenes.unseen.objects import unseen_objects

FIRST_ID = 101
"""Beyond the ids of YCB-Video."""

SCENES, FRAMES = 8, 5
SEQUENCES, SEQUENCE_FRAMES = 24, 30
SEED = 0


def unseen_set() -> list[SetObject]:
    """The objects with their ids; `texture` in models_info.json tells those with little."""
    return [
        SetObject(number, obj.name, obj.mesh, np.zeros(3), {"texture": "little"} if obj.plain else {})
        for number, obj in enumerate(unseen_objects(SEED), FIRST_ID)
    ]


def write_unseen(
    out: Path, scenes: int = SCENES, frames: int = FRAMES, sequences: int = SEQUENCES
) -> list[SetObject]:
    """`out/ycbv` in BOP's layout, with the meshes, and `out/fast` in that of Fast-YCB; what is there is kept.
    Raises InputError."""
    objects = unseen_set()
    write_bop_ycbv(out / "ycbv", objects, scenes, frames, SEED, SceneRanges())
    write_fast_ycb_set(out / "fast", objects, sequences, SEQUENCE_FRAMES, SEED)
    return objects
