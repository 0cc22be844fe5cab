"""Plays the films of a split to trackers, each film as one job; with a nearly perfect perception, or without
any."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.believe.state import State
from huepose.datasets.types import VISIBLE
from huepose.estimation.types import PoseEstimate
from huepose.geometry import se3
from huepose.model import ReferenceModel, load_models
from huepose.reinit.judge import displacement_m
from huepose.reinit.types import ObjectSlot, Request, RequestedObject
from huepose.support.files import cache_folder
from huepose.tracking import Tracker
from studies.stress.causes import runs
from studies.stress.films import Film, Seen, recorded, rendered
from studies.stress.objects import builtin_meshes, household_meshes, onboarded, unseen_meshes
from studies.stress.play import play

SHIFT_M, TURN_RAD = 0.002, 0.02
"""Standard deviations of the oracle's errors per axis, as of a good single-frame estimate."""

SCORE, SCORE_PER_DIAMETER = 1.9, 2.5
"""The oracle's score of a right pose, and the loss per diameter of displacement, at most 1.2."""


class Oracle:
    """Nearly perfect perception: the true pose of a visible object with normal errors, and a score of the
    tracked pose to compare it with."""

    def __init__(self, model: ReferenceModel, seed: int = 0) -> None:
        self._slot = ObjectSlot.of(model)
        self._rng = np.random.default_rng([seed, 50])

    def answer(self, request: Request, seen: Seen) -> list[PoseEstimate]:
        """An estimate of the requested object, if it is visible."""
        if seen.visib_fract < VISIBLE:
            return []
        return [self._estimate(asked, seen) for asked in request.objects[:1]]

    def _estimate(self, asked: RequestedObject, seen: Seen) -> PoseEstimate:
        slot, truth = self._slot, seen.T_cam_obj
        errors = np.concatenate([self._rng.normal(0, SHIFT_M, 3), self._rng.normal(0, TURN_RAD, 3)])
        T, prior_score, prior = se3.perturb(truth, errors), None, None
        if asked.prior is not None:
            prior = asked.prior.predicted(seen.frame.stamp_ns, slot.middle_obj)
            off = displacement_m(prior, truth, slot) / slot.diameter_m
            prior_score = SCORE - min(SCORE_PER_DIAMETER * max(off - 0.1, 0.0), 1.2)
        instance = -1 if asked.instance is None else asked.instance
        covariance = np.diag([SHIFT_M**2] * 3 + [TURN_RAD**2] * 3)
        return PoseEstimate(
            asked.object,
            instance,
            True,
            T,
            quality=0.95,
            state=State.TRACKING,
            score=SCORE,
            covariance=covariance,
            prior_score=prior_score,
            prior_T_cam_obj=prior,
        )


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
"""Procedural objects: hard ones; random bowls, mugs, tools, fruit and packages, as in training; and those on
which results are reported."""

KINDS = ("carried", "plain", "leaves", "carried", "swapped")
MODES = ("alone", "with_loop")

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Job:
    """One film: its split and number, or a recorded one. objects: the folder of the reference models, or a
    key of OBJECTS; kind: what happens in the film, by default one of KINDS by its number."""

    split: str
    number: int
    objects: Path | str
    recorded: Path | None
    modes: tuple[str, ...]
    kind: str | None = None

    @property
    def name(self) -> str:
        """Unique in a folder of results."""
        if self.recorded is not None:
            return str(self.recorded)
        objects = self.objects if isinstance(self.objects, str) else "bundles"
        return "-".join([self.split, objects, str(self.number), *([] if self.kind is None else [self.kind])])


def missing(jobs: Sequence[Job], rows: Iterable[Row]) -> list[Job]:
    """The jobs of which rows are missing, each with the missing modes."""
    done = {(row["job"], row.get("mode")) for row in rows}
    left = [
        replace(job, modes=tuple(mode for mode in job.modes if (job.name, mode) not in done)) for job in jobs
    ]
    # A row without a mode says that there is nothing to play.
    return [job for job in left if job.modes and (job.name, None) not in done]


def asked_for(jobs: Sequence[Job], rows: Iterable[Row]) -> list[Row]:
    """The rows of these jobs and modes."""
    modes = {job.name: (*job.modes, None) for job in jobs}
    return [row for row in rows if row.get("mode") in modes.get(row["job"], ())]


@cache
def models_of(split: str, objects: Path | str) -> Mapping[str, ReferenceModel]:
    if isinstance(objects, Path):
        return load_models(objects)
    seed = SPLITS[split].seed
    return onboarded(OBJECTS[objects](seed), cache_folder() / "stress" / f"{objects}-{seed}")


def film_of(job: Job) -> tuple[Film | None, Mapping[str, ReferenceModel]]:
    """The film of a job, and all models. The film is None if its object has no look-alike to swap it for."""
    split, models = SPLITS[job.split], models_of(job.split, job.objects)
    if job.recorded is not None:
        return recorded(job.recorded, models), models
    names = sorted(models)
    if isinstance(job.objects, Path):
        names = sorted(n for n, m in models.items() if m.object_id in split.objects)
    model, kind = models[names[job.number % len(names)]], job.kind or KINDS[job.number % len(KINDS)]
    return rendered(cache_folder() / "stress", kind, model, models, split.seed, job.number), models


def played(job: Job) -> list[Row]:
    """One row for each run of a film and each mode, with the published state of every frame; one row without
    frames if there is no run."""
    cv2.setNumThreads(1)
    film, models = film_of(job)
    if film is None:
        return [{"job": job.name, "frames": []}]
    seed = SPLITS[job.split].seed
    model, rows = models[film.object], list[Row]()
    for run in runs(film, model, seed):
        for mode in job.modes:
            tracker = Tracker({film.object: model})
            perception = Oracle(model, seed) if mode == "with_loop" else None
            moments = play(run.frames, model, tracker, run.first, run.quality, perception)
            facts = {"job": job.name, "mode": mode, "cause": run.cause, "run": run.name}
            frames = [astuple(moment) for moment in moments]
            rows.append({**facts, "object": film.object, "film": film.name, "frames": frames})
    return rows or [{"job": job.name, "frames": []}]
