"""The runs behind the tables: images for the estimators, sequences for the trackers, into journals."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from huepose.datasets.types import Scene
from huepose.evaluation.estimate_protocol import EstimateSetup
from huepose.evaluation.tables.journal import Entry, Journal
from huepose.evaluation.track_rows import TrackResult
from huepose.support.errors import InputError
from huepose.support.progress import progress


def run_images(journal: Journal, scenes: Sequence[Scene], setup: EstimateSetup, label: str) -> list[Entry]:
    """Estimate in all images that the journal does not have yet. An image that cannot be read is kept with
    the reason, and is tried again the next time. Returns the entries of these images."""
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
    journal: Journal, scenes: Sequence[Scene], every: int, track: Callable[[Scene], TrackResult]
) -> list[Entry]:
    """Track all sequences that the journal does not have yet; one that cannot be read is kept with the
    reason. Returns the entries of these sequences."""
    keys = []
    for scene in scenes:
        key = f"{scene.name}/every {every}/{len(scene.image_ids)} frames"
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
