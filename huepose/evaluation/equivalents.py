"""Labels that the texture contradicts or cannot confirm: the poses that count as well (`--equivalent`).

`{"SCENE/IMAGE/INSTANCE": {"T_obj_obj": [4x4, ...]}}`, metres; the labelled pose times each counts as right.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from huepose.datasets import files
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.support.errors import InputError

Key = tuple[str, int, int]


def read_equivalents(path: Path | str) -> dict[Key, tuple[Float64, ...]]:
    """Transforms `T_obj_obj` (4, 4) by (scene, image, instance). Raises InputError, naming the entry."""
    result: dict[Key, tuple[Float64, ...]] = {}
    for key, entry in files.read_json(Path(path)).items():
        where = f"{path}, '{key}'"
        scene, _, rest = key.rpartition("/")[0].rpartition("/")
        parts = [rest, key.rpartition("/")[2]]
        if not scene or not all(part.isdigit() for part in parts):
            raise InputError(where, found="this key", expected="SCENE/IMAGE/INSTANCE, as in '000001/4/2'")
        transforms = files.field(entry, "T_obj_obj", where)
        try:
            array = np.asarray(transforms, dtype=np.float64).reshape(-1, 4, 4)
        except (TypeError, ValueError):
            array = np.full((1, 4, 4), np.nan)
        if not all(se3.is_rigid(T, 1e-3) for T in array):
            raise InputError(where, found="T_obj_obj that is no rigid transform", expected="4x4 matrices")
        result[scene, int(parts[0]), int(parts[1])] = tuple(se3.orthonormalised(T) for T in array)
    return result
