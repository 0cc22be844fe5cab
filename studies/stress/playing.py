"""Playing the films of a split to trackers, each film a job of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2

from huepose.model import ReferenceModel, load_models
from huepose.support.files import cache_folder
from huepose.tracking import Tracker
from studies.stress.causes import runs
from studies.stress.films import Film, drawn, recorded
from studies.stress.objects import builtin_meshes, household_meshes, learned, unseen_meshes
from studies.stress.oracle import Oracle
from studies.stress.play import play


@dataclass(frozen=True)
class Split:
    """seed: of films, and of the textures of the built-in objects; objects: BOP ids of reference models."""

    seed: int
    objects: tuple[int, ...]


SPLITS = {
    "fit": Split(41, (1, 3, 5, 8, 12, 15, 18, 20)),
    "choose": Split(42, (2, 4, 7, 17)),
    "report": Split(43, (6, 9, 10, 11, 14, 19, 21)),
}
OBJECTS = {"builtin": builtin_meshes, "household": household_meshes, "unseen": unseen_meshes}
"""Objects made by code: hard ones; random bowls, mugs, tools, fruit and packages, as in training; and those
that results are reported on."""

KINDS = ("carried", "plain", "leaves", "carried", "swapped")
MODES = ("alone", "with_loop")

Row = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """One film: of a split and its number there, or recorded. objects: the folder of the reference models, or
    a name among OBJECTS."""

    split: str
    number: int
    objects: Path | str
    recorded: Path | None
    modes: tuple[str, ...]

    @property
    def name(self) -> str:
        """Unique in a folder of results."""
        kind = self.objects if isinstance(self.objects, str) else "bundles"
        return str(self.recorded) if self.recorded is not None else f"{self.split}-{kind}-{self.number}"


@cache
def models_of(split: str, objects: Path | str) -> Mapping[str, ReferenceModel]:
    if isinstance(objects, Path):
        return load_models(objects)
    seed = SPLITS[split].seed
    return learned(OBJECTS[objects](seed), cache_folder() / "stress" / f"{objects}-{seed}")


def film_of(job: Job) -> tuple[Film | None, Mapping[str, ReferenceModel]]:
    """The film of a job, None where its object has no look-alike to be swapped for, and all models."""
    split, models = SPLITS[job.split], models_of(job.split, job.objects)
    if job.recorded is not None:
        return recorded(job.recorded, models), models
    names = sorted(models)
    if isinstance(job.objects, Path):
        names = sorted(n for n, m in models.items() if m.object_id in split.objects)
    model, kind = models[names[job.number % len(names)]], KINDS[job.number % len(KINDS)]
    return drawn(cache_folder() / "stress", kind, model, models, split.seed, job.number), models


def played(job: Job) -> list[Row]:
    """All runs of a film: what was published in every frame; one row without frames where there is none."""
    cv2.setNumThreads(1)
    film, models = film_of(job)
    if film is None:
        return [{"job": job.name, "frames": []}]
    seed = SPLITS[job.split].seed
    model, rows = models[film.object], []
    for run in runs(film, model, seed):
        for mode in job.modes:
            tracker = Tracker({film.object: model})
            perception = Oracle(model, seed) if mode == "with_loop" else None
            told = play(run.frames, model, tracker, run.first, run.quality, perception)
            facts = {"job": job.name, "mode": mode, "cause": run.cause, "run": run.name}
            frames = [astuple(moment) for moment in told]
            rows.append({**facts, "object": film.object, "film": film.name, "frames": frames})
    return rows or [{"job": job.name, "frames": []}]
