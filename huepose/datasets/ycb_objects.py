"""The 21 objects of YCB-Video: names, BOP ids, and how the model frames in use lie to each other.

The numbers and where they come from are in `ycb_objects.json`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets import files
from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64

_SAME = 0.01
"""Share by which a diameter may differ: meshes of one object differ by 0.3 %, two objects by more."""


@dataclass(frozen=True, eq=False)
class YcbObject:
    """diameter_m: None where unknown; frame_offset_m (3,): takes a point of the PoseCNN (YCB-Video) frame to
    BOP's; T_nvdu_posecnn (4, 4): to NVIDIA's frame, None where unknown."""

    object_id: int
    name: str
    diameter_m: float | None
    frame_offset_m: Float64
    T_nvdu_posecnn: Float64 | None


@cache
def ycb_objects() -> Mapping[int, YcbObject]:
    """All 21, by BOP id."""
    path = Path(__file__).with_name("ycb_objects.json")
    return {entry["id"]: _object(entry, path) for entry in json.loads(path.read_text())["objects"]}


def _object(entry: dict[str, Any], path: Path) -> YcbObject:
    T_nvdu = None
    if "posecnn_to_nvdu_R" in entry:
        R = files.numbers(entry, "posecnn_to_nvdu_R", (3, 3), path)
        T_nvdu = files.rigid(R, files.numbers(entry, "posecnn_to_nvdu_t_m", (3,), path), path)
    diameter = entry.get("diameter_mm")
    return YcbObject(
        entry["id"],
        entry["name"],
        None if diameter is None else diameter / 1000.0,
        files.numbers(entry, "posecnn_to_bop_t_mm", (3,), path) / 1000.0,
        T_nvdu,
    )


def ycb_named(name: str) -> YcbObject | None:
    """The object of that name.

    >>> ycb_named("006_mustard_bottle").object_id
    5
    """
    return next((known for known in ycb_objects().values() if known.name == name), None)


def is_ycbv(diameters_mm: Mapping[int, float]) -> bool:
    """A models folder with these diameters by BOP id is YCB-Video's: those known here agree by 1 %."""
    pairs = [
        (diameters_mm[i], 1000.0 * known.diameter_m)
        for i, known in ycb_objects().items()
        if known.diameter_m is not None and i in diameters_mm
    ]
    return bool(pairs) and all(abs(theirs - ours) <= _SAME * ours for theirs, ours in pairs)


def T_posecnn_obj(frame_offset_m: Float) -> Float64:
    """From the reference model's frame to PoseCNN's (4, 4), of the offset (3,) the other way round."""
    return se3.make(np.eye(3), -np.asarray(frame_offset_m, dtype=np.float64))
