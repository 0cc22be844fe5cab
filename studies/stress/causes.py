"""The runs of a film, by cause: large steps, jumps, wrong first poses, frames skipped on a loaded machine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, cycle, takewhile

import numpy as np

from huepose.geometry import RgbdFrame, se3
from huepose.geometry.arrays import Float64, Rng
from huepose.model import ReferenceModel
from studies.stress.films import Film, Seen

STEPS = (1, 3, 5, 7, 10, 15)
OFFSETS = 3
"""Largest number of runs with one step, each from another first frame."""

WRONG_STARTS = ("shifted", "turned", "turned over", "elsewhere", "on another object", "in the table")
CLAIMED = 0.9
"""Quality that is given with a wrong first pose."""

JUMP_AT, JUMP_FRAMES = 15, 20
LEAST_VISIBLE = 0.5
"""A run begins with a frame in which at least this share of the object is visible."""

LOADED_GAPS = (1, 2, 1, 2, 1, 1, 2, 1, 2, 1, 1, 1, 1, 1, 1, 3, 1, 1, 1, 1, 2, 1, 1, 26)
"""Steps between the frames that a tracker received, as recorded with six busy processes on two cores; the
last one is a search that had to wait for the CPU."""


@dataclass(frozen=True, eq=False)
class Run:
    """Input of a tracker: frames in order with their timestamps, and the first pose with its quality."""

    name: str
    cause: str
    frames: tuple[Seen, ...]
    first: Float64
    quality: float = 1.0


def runs(film: Film, model: ReferenceModel, seed: int) -> Iterator[Run]:
    """All runs that a film allows."""
    rng = np.random.default_rng([seed, *film.name.encode()])
    if film.kind in ("carried", "recorded"):
        for step in STEPS:
            for k in range(min(step, OFFSETS)):
                offset = k * step // min(step, OFFSETS)
                yield from _run(
                    film, f"step {step}", range(offset, len(film.frames), step), f" from {offset}"
                )
        last = range(JUMP_AT + JUMP_FRAMES, len(film.frames))
        yield from _run(film, "jump", (*range(JUMP_AT), *last), at_once=True)
        yield from _run(film, "loaded machine", loaded_schedule(len(film.frames)))
        for cause in WRONG_STARTS:
            yield from _wrong(film, model, cause, rng)
    else:
        for step in (1, 5):
            yield from _run(film, film.kind, range(0, len(film.frames), step), f" step {step}")


def loaded_schedule(count: int) -> list[int]:
    """The numbers of the frames, of `count` at 30 Hz, that a tracker receives on a loaded machine."""
    kept = accumulate(cycle(LOADED_GAPS), initial=0)
    return list(takewhile(lambda i: i < count, kept))


def _run(
    film: Film, cause: str, chosen: Sequence[int], suffix: str = "", at_once: bool = False
) -> Iterator[Run]:
    kept = [film.frames[i] for i in chosen]
    while kept and kept[0].visib_fract < LEAST_VISIBLE:
        kept.pop(0)
    if len(kept) < 2:
        return
    if at_once:
        # Timestamps without the frames between: the object jumps to another position.
        stamps = [round(k * 1e9 / 30.0) for k in range(len(kept))]
        kept = [
            replace(s, frame=replace(s.frame, frame_id=k, stamp_ns=t))
            for k, (s, t) in enumerate(zip(kept, stamps, strict=True))
        ]
    yield Run(f"{film.name}: {cause}{suffix}", cause, tuple(kept), kept[0].T_cam_obj)


def _wrong(film: Film, model: ReferenceModel, cause: str, rng: Rng) -> Iterator[Run]:
    begin = int(rng.integers(0, len(film.frames) // 3))
    shown = [s for s in film.frames[begin:] if s.visib_fract >= LEAST_VISIBLE]
    if not shown:
        return
    kept = film.frames[shown[0].frame.frame_id :][:40]
    truth, frame = kept[0].T_cam_obj, kept[0].frame
    centre, R = truth[:3, :3] @ model.mesh.centre + truth[:3, 3], truth[:3, :3]
    if cause == "shifted":
        shift = rng.normal(0, 1, 3)
        centre = centre + shift / np.linalg.norm(shift) * model.diameter_m * rng.uniform(0.2, 2.0)
    elif cause == "turned":
        R = _rotation(rng, rng.uniform(np.pi / 4, np.pi)) @ R
    elif cause == "turned over":
        if len(model.near_symmetries) < 2:
            return
        near = model.near_symmetries[1 + int(rng.integers(len(model.near_symmetries) - 1))]
        R, centre = (truth @ near)[:3, :3], (truth @ near @ np.append(model.mesh.centre, 1.0))[:3]
    elif cause == "elsewhere":
        centre, R = on_a_surface(frame, rng), _rotation(rng, rng.uniform(0, np.pi)) @ R
    elif cause == "in the table":
        at = on_a_surface(frame, rng)
        centre = at * (1.0 + 0.5 * model.diameter_m / float(at[2]))
    elif not len(film.others):
        return
    else:
        other = film.others[int(rng.integers(len(film.others)))]
        R, centre = other[:3, :3], other[:3, 3]
        pixel = frame.camera.project(centre[None])[0]
        if not (0 <= pixel[0] < frame.camera.width and 0 <= pixel[1] < frame.camera.height):
            return
    first = se3.make(R, centre - R @ model.mesh.centre)
    yield Run(f"{film.name}: {cause}", cause, kept, first, CLAIMED)


def _rotation(rng: Rng, angle: float) -> Float64:
    axis = rng.normal(size=3)
    return se3.rotation_exp(axis / np.linalg.norm(axis) * angle)


def on_a_surface(frame: RgbdFrame, rng: Rng) -> Float64:
    """A random point (3,) of the depth, camera axes."""
    rows, columns = np.nonzero(frame.depth > 0.3)
    k = int(rng.integers(len(rows)))
    pixel = np.array([[columns[k], rows[k]]], float)
    return np.asarray(frame.camera.backproject(pixel, frame.depth[rows[k : k + 1], columns[k : k + 1]])[0])
