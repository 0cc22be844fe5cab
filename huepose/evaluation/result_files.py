"""Results as JSON. Numbers that are not finite become null, and files are written atomically. `origin` gives
machine, versions, command and date."""

from __future__ import annotations

import json
import math
import os
import platform
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from huepose.support.errors import InputError
from huepose.support.extras import installed_version
from huepose.support.files import write_text


def plain(value: Any) -> Any:
    """`value` in JSON's types: arrays become lists, nan and inf None, keys text.

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


def result_names(paths: Sequence[Path]) -> list[str]:
    """Unique names of result files: the file's name, for a `results.json` its folder's. If some are equal,
    parent folders are put before all. Raises InputError if that does not make them unique.

    >>> result_names([Path("a/track.json"), Path("b/results.json")])
    ['track', 'b']
    >>> result_names([Path("a/track.json"), Path("b/track.json")])
    ['a-track', 'b-track']
    """
    whole = [path.absolute() for path in paths]
    parts = [(path.parent if path.name == "results.json" else path.with_suffix("")).parts for path in whole]
    for length in range(1, max(map(len, parts), default=0) + 1):
        names = ["-".join(part[-length:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    raise InputError(
        ", ".join(map(str, paths)), found="result files of the same name", expected="each file once"
    )


def write_json(path: Path | str, value: Any) -> None:
    """Write `value` as JSON: one line for each key, and for each item of its lists. Raises InputError."""
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


_PACKAGES = ("huepose", "numpy", "scipy", "numba", "opencv-python-headless")
_SLASHED = re.compile(r"(?:[\w.~-]*/)+(?=[\w.-])")


def origin(arguments: Sequence[str] | None = None) -> dict[str, str]:
    """`date` (UTC), `command` with paths cut to their last part, `machine` in general terms, `versions`.

    arguments: of the command, by default those of this process."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    return {
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%d"),
        "command": shlex.join(["huepose", *(_SLASHED.sub("", word) for word in words)]),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, "
        f"Python {platform.python_version()}",
        "versions": ", ".join(f"{name} {found}" for name in _PACKAGES if (found := installed_version(name))),
    }
