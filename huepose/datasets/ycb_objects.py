"""The 21 objects of YCB-Video: names, BOP ids, and the transforms between the model frames in use.

The numbers and their sources are in `ycb_objects.json`.
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
"""Share by which a diameter may differ: meshes of the same object differ by 0.3 %, different objects by
more."""


@dataclass(frozen=True, eq=False)
class YcbObject:
    """diameter_m: None if unknown; frame_offset_m (3,): offset from the PoseCNN (YCB-Video) frame to BOP's,
    added to points; T_nvdu_posecnn (4, 4): from the PoseCNN frame to NVIDIA's, None if unknown."""

    object_id: int
    name: str
    diameter_m: float | None
    frame_offset_m: Float64
    T_nvdu_posecnn: Float64 | None


@cache
def ycb_objects() -> Mapping[int, YcbObject]:
    """All 21 objects, by BOP id."""
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
    """Whether the diameters by BOP id of a models folder are YCB-Video's: those known here agree to 1 %."""
    pairs = [
        (diameters_mm[i], 1000.0 * known.diameter_m)
        for i, known in ycb_objects().items()
        if known.diameter_m is not None and i in diameters_mm
    ]
    return bool(pairs) and all(abs(theirs - ours) <= _SAME * ours for theirs, ours in pairs)


def T_posecnn_obj(frame_offset_m: Float) -> Float64:
    """T (4, 4) from the reference model's frame to PoseCNN's; frame_offset_m (3,) is for the other
    direction."""
    return se3.make(np.eye(3), -np.asarray(frame_offset_m, dtype=np.float64))
