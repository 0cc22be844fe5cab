"""A set of rendered frames as a BOP scene folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from huepose.datasets.bop_writer import BopWriter, Label
from huepose.geometry import Mesh
from huepose.scenes.frame import silhouette
from huepose.scenes.rendered import Drawn, SceneRanges, check_sizes, rendered_frame
from huepose.support.errors import InputError
from huepose.support.progress import progress

VERSION = 1
"""Of what the code draws: raise it when the same seed gives other pictures."""


def write_rendered_set(
    folder: Path,
    meshes: Mapping[str, Mesh],
    object_ids: Mapping[str, int],
    frames: int,
    seed: int,
    ranges: SceneRanges | None = None,
    color_suffix: str = ".jpg",
) -> None:
    """Draw frames 0 to `frames` - 1 of the set `seed` into a folder; those that are there already are kept.

    meshes: in metres, by name; object_ids: BOP ids by name. Raises InputError for a folder that holds
    something else, no frames, or meshes that cannot be drawn."""
    if frames < 1:
        raise InputError("--frames", found=str(frames), expected="1 or more")
    ranges = ranges or SceneRanges()
    check_sizes(meshes)
    facts = {
        "version": VERSION,
        "seed": seed,
        "objects": {name: object_ids[name] for name in sorted(meshes)},
        "ranges": asdict(ranges),
    }
    writer = BopWriter(folder, facts, color_suffix)
    missing = [number for number in range(frames) if number not in writer.done]
    for number in progress(missing, f"drawing {folder.name}") if missing else ():
        drawn = rendered_frame(meshes, seed, number, ranges)
        writer.add(
            number, drawn.shot.color, drawn.shot.depth, drawn.camera, _labels(drawn, meshes, object_ids)
        )


def _labels(drawn: Drawn, meshes: Mapping[str, Mesh], object_ids: Mapping[str, int]) -> list[Label]:
    labels = []
    for k, name in enumerate(drawn.names):
        T = drawn.shot.labels.T_cam_obj[k]
        count, box = silhouette(meshes[name], T, drawn.camera)
        labels.append(Label(object_ids[name], T, np.asarray(drawn.shot.owner == k), count, box))
    return labels
