"""Where a result comes from: machine, versions, command, date; kept in every result file."""

from __future__ import annotations

import os
import platform
import re
import shlex
import sys
from collections.abc import Sequence
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("huepose", "numpy", "scipy", "numba", "opencv-python-headless")
_SLASHED = re.compile(r"(?:[\w.~-]*/)+(?=[\w.-])")


def origin(arguments: Sequence[str] | None = None) -> dict[str, str]:
    """`date` (UTC), `command` with paths cut to their last part, `machine` in general words, `versions`.

    arguments: of the command, by default those of this process."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    return {
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%d"),
        "command": shlex.join(["huepose", *(_SLASHED.sub("", word) for word in words)]),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, "
        f"Python {platform.python_version()}",
        "versions": ", ".join(f"{name} {found}" for name in _PACKAGES if (found := _version(name))),
    }


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
