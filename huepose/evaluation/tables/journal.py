"""What a long evaluation has done so far, on disk: it may be stopped at any moment, and gone on with."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from huepose.evaluation.result_files import plain
from huepose.support.errors import InputError
from huepose.support.files import write_text

Entry = Mapping[str, Any]


class Journal:
    """A file with a line for each finished piece of work, after one with the settings.

    `entries`: by key, in the order in which they were added; of a piece that was done twice the last."""

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        """Open or begin. Raises InputError for a journal of other settings, or one that cannot be written."""
        self.path, self.entries = path, dict[str, Entry]()
        wanted = json.loads(json.dumps(plain(settings)))
        lines = path.read_text().splitlines(keepends=True) if path.exists() else []
        if lines and not lines[-1].endswith("\n"):
            lines.pop()  # it was cut off while it was written
        if lines and json.loads(lines[0]) != wanted:
            raise InputError(
                path,
                found=f"results with the settings {lines[0].strip()[:200]}",
                expected=json.dumps(wanted)[:200],
                fix="Choose another --out, or remove that file.",
            )
        for line in lines[1:]:
            entry = json.loads(line)
            self.entries[entry["key"]] = entry
        write_text(path, "".join(lines) if lines else json.dumps(wanted) + "\n")

    def done(self, key: str) -> bool:
        """The piece of work is there, and was no failure."""
        return key in self.entries and "error" not in self.entries[key]

    def add(self, key: str, entry: Entry) -> None:
        """Keep a finished piece of work."""
        whole = plain({"key": key, **entry})
        self.entries[key] = whole
        with self.path.open("a") as file:
            file.write(json.dumps(whole, allow_nan=False) + "\n")
