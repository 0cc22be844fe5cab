"""The fitted numbers of all beliefs, in one file, each with where it comes from.

`fits.json` has one entry for each question: `quality` (is the pose of a single frame right? by method),
`frame` (is a tracked pose right in this frame?) and `presence` (is the object there at all?). An entry has
the `fit` and its `origin`: the command that writes it, the data and the seeds they were drawn from.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Literal

Question = Literal["quality", "frame", "presence"]

PATH = Path(__file__).with_name("fits.json")


@cache
def _entries() -> dict[str, Any]:
    return dict(json.loads(PATH.read_text()))


def fitted(question: Question) -> Mapping[str, Any]:
    """The fit that answers a question, as `write_fit` was given it."""
    return dict(_entries()[question]["fit"])


def write_fit(question: Question, fit: Mapping[str, Any], path: Path = PATH) -> None:
    """Put a fit in the package; where it comes from stays as written. For the commands of `studies`."""
    entries = json.loads(path.read_text())
    entries[question]["fit"] = fit
    path.write_text(json.dumps(entries, indent=1) + "\n")
