"""The verdict of onboarding on an object, kept beside its reference model as `BUNDLES/NAME.verdict.json`."""

from __future__ import annotations

import json
from pathlib import Path

from huepose.model import ReferenceModel
from huepose.support.files import write_text


def verdict_path(bundles: Path, name: str) -> Path:
    """Where the verdict on the object of that name is kept."""
    return bundles / f"{name}.verdict.json"


def keep_verdict(bundles: Path, model: ReferenceModel, verdict: str, words: str) -> None:
    """Keep the verdict on a model and the line that says it. Raises InputError where it cannot write."""
    kept = {"model": model.digest, "verdict": verdict, "words": words}
    write_text(verdict_path(bundles, model.name), json.dumps(kept, indent=1) + "\n")


def limits(bundles: Path, model: ReferenceModel) -> str:
    """The line about an object that does not suit, or suits with limits; empty for one that suits, and where
    the verdict is on another model of that name, or none is kept."""
    try:
        kept = json.loads(verdict_path(bundles, model.name).read_text(encoding="utf-8"))
        of_it = kept["model"] == model.digest and kept["verdict"] != "suits"
        return str(kept["words"]) if of_it else ""
    except (OSError, ValueError, KeyError, TypeError):
        return ""
