"""Results as JSON: numbers that are none become null, and a file is there as a whole or not at all."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from huepose.support.errors import InputError


def plain(value: Any) -> Any:
    """`value` in JSON's types: arrays to lists, nan and inf to None, keys to text.

    >>> plain({1: np.array([1.0, np.nan]), "b": np.int64(3)})
    {'1': [1.0, None], 'b': 3}
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_text(path: Path | str, text: str) -> None:
    """Write a file at once: a reader never sees a part of it. Makes missing folders. Raises InputError."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(name, 0o666 & ~umask)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise InputError(
            path, found=error.strerror or str(error), expected="a place that can be written"
        ) from None


def write_json(path: Path | str, value: Any) -> None:
    """Write `value` as JSON, one row of a list a line at the first two levels. Raises InputError."""
    write_text(path, _layout(plain(value)) + "\n")


def _layout(value: Any) -> str:
    if not isinstance(value, dict):
        return json.dumps(value, allow_nan=False)
    parts = []
    for key, item in value.items():
        if isinstance(item, list) and item:
            rows = ",\n".join(json.dumps(row, allow_nan=False) for row in item)
            parts.append(f"{json.dumps(key)}: [\n{rows}\n]")
        else:
            parts.append(f"{json.dumps(key)}: {json.dumps(item, allow_nan=False)}")
    return "{" + ",\n".join(parts) + "}"
