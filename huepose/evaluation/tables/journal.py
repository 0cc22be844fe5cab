"""Journals: the finished parts of a long evaluation on disk. It can be stopped at any time and continued.

Images are evaluated with the estimators, sequences with the trackers; the results are added to journals."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from huepose.datasets.types import Scene
from huepose.evaluation.estimate_protocol import EstimateSetup
from huepose.evaluation.result_files import plain
from huepose.evaluation.track_rows import TrackResult
from huepose.model.types import ReferenceModel
from huepose.support.errors import InputError
from huepose.support.files import write_text, writing
from huepose.support.progress import progress

Entry = Mapping[str, Any]


class Journal:
    """A file with a line with the settings, followed by one line for each finished part.

    `entries`: by key, in the order in which they were added; for a part that was done twice, the last one."""

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        """Open or create the file. Raises InputError if it has other settings, or cannot be written."""
        self.path, self.entries = path, dict[str, Entry]()
        wanted = json.loads(json.dumps(plain(settings)))
        lines = path.read_text().splitlines(keepends=True) if path.exists() else []
        if lines and not lines[-1].endswith("\n"):
            lines.pop()  # the process ended while it wrote this line
        try:
            settings, *entries = [json.loads(line) for line in lines] or [wanted]
            self.entries = {entry["key"]: entry for entry in entries}
        except (ValueError, KeyError, TypeError):
            raise InputError(
                path, found="not a journal", fix="Choose another place, or remove that file."
            ) from None
        if settings != wanted:
            raise InputError(
                path,
                found=f"results with {_different(settings, wanted)}",
                expected=_different(wanted, settings),
                fix="Choose another place (--out, --json), or remove that file.",
            )
        write_text(path, "".join(lines) if lines else json.dumps(wanted) + "\n")

    def done(self, key: str) -> bool:
        """Whether this part was finished without an error."""
        return key in self.entries and "error" not in self.entries[key]

    def add(self, key: str, entry: Entry) -> None:
        """Add a finished part. Raises InputError if it cannot be written."""
        whole = plain({"key": key, **entry})
        self.entries[key] = whole
        with writing(self.path), self.path.open("a") as file:
            file.write(json.dumps(whole, allow_nan=False) + "\n")


def _different(settings: Any, other: Any) -> str:
    """The settings that differ from those in `other` or are missing there, in words."""
    if isinstance(settings, Mapping) and isinstance(other, Mapping):
        settings = {key: value for key, value in settings.items() if (key, value) not in other.items()}
    return f"the settings {json.dumps(settings)[:200]}"


def models_digest(models: Iterable[ReferenceModel]) -> str:
    """A digest of a set of reference models."""
    files = sorted((model.name, str(model.digest)) for model in models)
    return hashlib.sha256(repr(files).encode()).hexdigest()[:16]


def run_images(journal: Journal, scenes: Sequence[Scene], setup: EstimateSetup, label: str) -> list[Entry]:
    """Evaluate all images that are not in the journal. An image that cannot be read is added with the reason,
    and is tried again the next time. Returns the entries of all images."""
    images = [(scene, image) for scene in scenes for image in scene.image_ids]
    missing = [(s, i) for s, i in images if not journal.done(_key(s, i))]
    for scene, image in progress(missing, label) if missing else ():
        try:
            answers = setup.image(scene, image)
        except InputError as error:
            journal.add(_key(scene, image), {"error": str(error)})
            continue
        rows = [row.as_json() for row in answers.rows]
        entry = {"rows": rows, "false": len(answers.false), "without_model": answers.without_model}
        journal.add(_key(scene, image), entry)
    return [journal.entries[_key(scene, image)] for scene, image in images]


def _key(scene: Scene, image: int) -> str:
    return f"{scene.name}/{image}"


def run_tracks(
    journal: Journal,
    scenes: Sequence[Scene],
    every: int,
    track: Callable[[Scene], TrackResult],
    inputs: Mapping[str, str],
) -> list[Entry]:
    """Track all sequences that are not in the journal. A sequence that cannot be read is added with the
    reason. inputs: a digest of each sequence's inputs; if it changes, the sequence is tracked again.
    Returns the entries of all sequences."""
    keys = []
    for scene in scenes:
        key = f"{scene.name}/every {every}/{len(scene.image_ids)} frames/{inputs[scene.name]}"
        keys.append(key)
        if journal.done(key):
            continue
        name = {"sequence": scene.name, "every": every}
        try:
            result = track(scene)
        except InputError as error:
            journal.add(key, {**name, "error": str(error)})
            continue
        summary = result.summary()["sequences"][scene.name]
        journal.add(key, {**name, "summary": summary, "rows": [row.as_json() for row in result.rows]})
    return [journal.entries[key] for key in keys]
