"""Checks of a mesh before onboarding, and its unit.

If the mesh has no unit, the likely one is assumed and printed, or the user is asked, or an error demands it.
Notes say if the mesh has several parts, is partly transparent, or has its origin far away."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from huepose.support.errors import InputError
from huepose.support.lengths import LIKELY, METRES, NAMES, Unit, length
from huepose.support.words import first_of
from huepose_services.cli.options import say

if TYPE_CHECKING:
    from huepose.onboarding.batch import Job
    from huepose.onboarding.meshes import Looked

SMALL_M, LARGE_M = 0.03, 0.6
"""Usual range of the largest side of an object that is handled; outside it, the unit may be wrong."""

FAR = 2.0
"""Distance from a mesh's origin to its middle, in diameters, from which a note is printed."""

CLEAR = 0.02
"""Transparent share of the surface from which a note is printed."""

_NAMED = 5
"""Most parts of a mesh that a note names."""


def with_unit(job: Job) -> Job:
    """The job with its unit, after the notes about its mesh.

    A given unit is kept, with a warning if the size is unusual. Without one, glTF is read in metres; other
    meshes are read in metres or millimetres if their size is usual then, else the user is asked at a
    terminal. Raises InputError if there is no terminal."""
    from huepose.onboarding.meshes import look_at

    looked = look_at(job.mesh_path)
    job = _with_unit(job, looked.sizes)
    _say_of_parts(looked.parts)
    _say_of_clear(looked.clear)
    if job.unit in looked.sizes:
        _say_of_origin(looked, job.unit)
    return job


def _with_unit(job: Job, sizes: dict[Unit, float]) -> Job:
    from huepose.onboarding.meshes import unit_of_format

    standard = unit_of_format(job.mesh_path)
    if job.unit is not None:
        _warn_of(job.unit, sizes)
        return job
    taken = standard or next((unit for unit in sizes if unit in LIKELY), None)
    if not sizes or (standard and standard not in sizes):
        return job  # reading the mesh will fail
    usual = taken is not None and SMALL_M < sizes[taken] < LARGE_M
    if taken is None or not (usual or standard):
        return replace(job, unit=_asked(job.mesh_path, sizes))
    if not standard:
        _note("the mesh gives no unit, and", taken, sizes)
    elif not usual:
        _note(f"a {job.mesh_path.suffix} file", taken, sizes)
    return replace(job, unit=taken)


def _say_of_parts(parts: tuple[str, ...]) -> None:
    """Print a note about a file with several meshes: they may be several objects."""
    if len(parts) > 1:
        say(
            f"note: the file has {len(parts)} meshes: {first_of(parts, _NAMED)}; they are taken as "
            "one object. If they are several objects, export each to its own file"
        )


def _say_of_clear(share: float) -> None:
    """Print a note about transparent surfaces: glass, or a texture with holes (a label on its own sheet)."""
    if share > CLEAR:
        say(
            f"note: {100.0 * share:.0f} % of the surface is transparent; it is read as opaque, in the "
            "colour of its texture or material. Check in the image beside the reference model whether "
            "that is right; else remove these parts, or fill the holes of the texture"
        )


def _say_of_origin(looked: Looked, unit: Unit) -> None:
    """Print a note if the origin is far from the mesh, as in coordinates of an assembly or a scan."""
    if looked.away >= FAR * looked.diameter:
        say(
            f"note: the mesh's origin lies {length(looked.away * METRES[unit])} from the object; poses are "
            "poses of that origin. For poses of the object itself, move the origin to it and export again"
        )


def _warn_of(given: Unit, sizes: dict[Unit, float]) -> None:
    """Print a warning if the given unit makes the mesh unusually small, or too large for rendered scenes. A
    size that no object has is refused when the mesh is read."""
    from huepose.scenes.rendered import LARGEST_M

    if given not in sizes or SMALL_M < sizes[given] <= LARGEST_M:
        return
    but = " or ".join(_size(sizes, unit) for unit in sizes if unit != given)
    text = f"its largest side is {length(sizes[given])} with --unit {given}"
    if sizes[given] > LARGEST_M:
        text += f": too large for rendered scenes (at most {length(LARGEST_M)})"
    say(f"warning: {text}{f'; it would be {but}' if but else ''}")


def _note(head: str, taken: Unit, sizes: dict[Unit, float]) -> None:
    """Print in which unit a mesh is read, and its size in other units."""
    others = [_size(sizes, unit) for unit in sizes if unit != taken]
    but = f" (it would be {', '.join(others)})" if others else ""
    side = f"its largest side is {length(sizes[taken])}{but}"
    say(f"note: {head} is read in {NAMES[taken]}: {side}. If this is wrong, give the unit with --unit.")


def _asked(path: Path, sizes: dict[Unit, float]) -> Unit:
    """Ask the user for the unit. Raises InputError without a terminal or an answer."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise InputError(
            path,
            found=f"no unit, and a largest side of {_in_words(sizes)}",
            expected="its unit: the size would be unusual in metres and in millimetres",
            fix=f"Give it: --unit {'|'.join(sizes)}.",
        )
    say(f"{path} gives no unit. Its largest side is {_in_words(sizes)}.")
    while True:
        print(f"In which unit is it, {', '.join(sizes)}? ", end="", file=sys.stderr, flush=True)
        said = sys.stdin.readline()
        if not said:
            raise InputError(path, found="no answer", expected="its unit", fix="Give it with --unit.")
        for unit in sizes:
            if said.strip().lower() == unit:
                return unit


def _in_words(sizes: dict[Unit, float]) -> str:
    return ", ".join(_size(sizes, unit) for unit in sizes)


def _size(sizes: dict[Unit, float], unit: Unit) -> str:
    return f"{length(sizes[unit])} in {NAMES[unit]}"
