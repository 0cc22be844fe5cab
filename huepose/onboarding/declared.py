"""Symmetries that a file declares, in the format of BOP's models_info.json."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets import files
from huepose.geometry import se3
from huepose.onboarding.symmetries import AXES
from huepose.support.errors import InputError

_NAMES = ("symmetries_discrete", "symmetries_continuous")
_FORM = (
    '{"symmetries_discrete": [[16 numbers, row by row], ...], '
    '"symmetries_continuous": [{"axis": [x, y, z], "offset": [x, y, z]}, ...]}, in millimetres'
)


def read_symmetries(path: Path | str) -> dict[str, Any]:
    """Checked entry with `symmetries_discrete` and `symmetries_continuous` (millimetres).

    Raises InputError for a missing or broken file, and for symmetries that are not transforms or axes.
    """
    path = Path(path)
    tree = files.read_json(path, fix="Give an axis of the mesh, x, y or z, or such a file.")
    if not any(n in tree for n in _NAMES):
        raise InputError(path, found="neither of the two lists", expected=_FORM)
    entry = {n: tree.get(n, []) for n in _NAMES}
    check_symmetries(entry, str(path))
    return entry


def symmetries_of(value: str | None) -> dict[str, Any] | str | None:
    """The value of --symmetric: an axis of the object ("x", "y" or "z"), or an entry of `read_symmetries`;
    None if it is not given."""
    return value if value is None or value in AXES else read_symmetries(value)


def check_symmetries(entry: Mapping[str, Any], where: str) -> None:
    """Raises InputError, naming `where`, for symmetries that are not rigid transforms or axes."""
    for name in _NAMES:
        if not isinstance(entry.get(name, []), list):
            raise InputError(f"{where} {name}", found=str(entry[name])[:80], expected=f"a list as in {_FORM}")
    for k, row in enumerate(entry.get("symmetries_discrete", [])):
        T = _numbers(row, 16)
        if T is None or not se3.is_rigid(T.reshape(4, 4), se3.ROUNDED):
            raise InputError(
                f"{where} symmetries_discrete[{k}]", found=str(row)[:80], expected="a rigid 4x4 transform"
            )
    for k, item in enumerate(entry.get("symmetries_continuous", [])):
        axis = _numbers(item.get("axis"), 3) if isinstance(item, dict) else None
        offset = _numbers(item.get("offset", [0, 0, 0]), 3) if isinstance(item, dict) else None
        if axis is None or offset is None or np.linalg.norm(axis) < 1e-6:
            raise InputError(
                f"{where} symmetries_continuous[{k}]",
                found=str(item)[:80],
                expected='{"axis": [x, y, z], "offset": [x, y, z]}',
            )


def _numbers(value: Any, count: int) -> np.ndarray | None:
    try:
        array = np.array(value, np.float64).reshape(-1)
    except (TypeError, ValueError):
        return None
    return array if len(array) == count and np.isfinite(array).all() else None
