"""Onboards many objects in worker processes, with events while it runs, and without incomplete files if it
stops."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from queue import Empty
from typing import Any

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.model.io import model_path, save_model
from huepose.onboarding.meshes import read_mesh
from huepose.onboarding.onboard import onboard_mesh
from huepose.onboarding.reference import silent
from huepose.support.errors import InputError
from huepose.support.lengths import Unit

MANY_TRIANGLES = 500_000
"""Simplifying a mesh of more triangles takes so long that the user is told."""


@dataclass(frozen=True, eq=False)
class Job:
    """One object to onboard; the fields are those of `read_mesh` and `onboard_mesh`."""

    mesh_path: Path
    name: str
    object_id: int | None = None
    unit: Unit | None = None
    info: Mapping[str, Any] | None = None
    symmetric: Mapping[str, Any] | str | None = None
    frame_offset_m: Float64 | None = None
    paper: bool = False


@dataclass(frozen=True)
class Onboarded:
    """An onboarded object: the file of its model, size_m (x, y, z) and diameter in metres, number of
    equivalent rotations, paper: whether it has the tables of the paper's method, notes: what may be wrong
    with its mesh."""

    name: str
    path: Path
    size_m: tuple[float, float, float]
    diameter_m: float
    equivalents: int
    file_bytes: int
    seconds: float
    paper: bool
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Failed:
    """An object whose mesh could not be used, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class StageBegun:
    """The object `name` begins a stage (one of `reference.STAGES`)."""

    name: str
    stage: str


Event = StageBegun | Onboarded | Failed


class _StoppedError(Exception):
    pass


def onboard_one(
    job: Job, bundles_dir: Path, report: Callable[[str], None], say: Callable[[str], None] = silent
) -> Onboarded:
    """Onboard an object in this process and save its model. report: called with each stage when it begins;
    say: called with a text before a long step."""
    start = time.monotonic()
    report("mesh")
    notes: list[str] = []
    mesh = read_mesh(job.mesh_path, job.unit, notes.append)
    if len(mesh.faces) > MANY_TRIANGLES:
        say(f"simplifying {len(mesh.faces):,} triangles, which may take minutes")
    model = onboard_mesh(
        mesh,
        job.name,
        object_id=job.object_id,
        info=job.info,
        symmetric=job.symmetric,
        frame_offset_m=job.frame_offset_m,
        paper=job.paper,
        report=report,
    )
    path = model_path(bundles_dir, job.name)
    save_model(model, path)
    x, y, z = (float(e) for e in np.ptp(model.mesh.vertices, axis=0))
    return Onboarded(
        job.name,
        path,
        (x, y, z),
        model.diameter_m,
        len(model.equivalents),
        path.stat().st_size,
        time.monotonic() - start,
        model.tables is not None,
        tuple(notes),
    )


def onboard_many(jobs: Sequence[Job], bundles_dir: Path, processes: int) -> Generator[Event, None, None]:
    """Onboard objects in worker processes, and yield events.

    A mesh that cannot be used gives a `Failed` event; the others continue. When the consumer stops early
    (also by Ctrl-C), workers stop at their next stage and leave no file. Raises RuntimeError if a worker
    dies.
    """
    context = multiprocessing.get_context("spawn")  # a fork after numba or OpenCV started threads may hang
    events, stop = context.Queue(), context.Event()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    pool = ProcessPoolExecutor(processes, context, _prepare_worker, (events, stop))
    futures: list[Future[None]] = []
    try:
        # Ctrl-C reaches all processes, but only this one must react. Its workers inherit the blocked
        # signal: a worker that is interrupted while it starts would die with a long traceback, or leave the
        # others waiting.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            futures = [pool.submit(_work, job, bundles_dir) for job in jobs]
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        left = len(jobs)
        while left:
            try:
                event = events.get(timeout=0.2)
            except Empty:
                _raise_if_broken(futures)
                continue
            left -= not isinstance(event, StageBegun)
            yield event
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)


def _raise_if_broken(futures: Sequence[Future[None]]) -> None:
    for future in futures:
        if future.done() and not future.cancelled() and (error := future.exception()) is not None:
            if isinstance(error, BrokenProcessPool):
                raise RuntimeError("an onboarding process died: is there enough memory?") from error
            raise error


_events: Any = None
_stop: Any = None


def _prepare_worker(events: Any, stop: Any) -> None:
    import cv2

    global _events, _stop
    _events, _stop = events, stop
    cv2.setNumThreads(1)


def _work(job: Job, bundles_dir: Path) -> None:
    def report(stage: str) -> None:
        if _stop.is_set():
            raise _StoppedError
        _events.put(StageBegun(job.name, stage))

    try:
        _events.put(onboard_one(job, bundles_dir, report))
    except InputError as error:
        _events.put(Failed(job.name, str(error)))
    except _StoppedError:
        pass
