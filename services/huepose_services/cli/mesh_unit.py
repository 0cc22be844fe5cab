"""What is said of a mesh before anything is learnt: its unit, which is settled where it gives none (said,
asked for, or demanded), that it is of several parts, partly transparent, that its origin is far off."""

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
"""Few objects that are handled have a smaller or larger largest side: such a mesh may be in another unit."""

FAR = 2.0
"""Diameters from its origin to the middle of a mesh from which it is said."""

CLEAR = 0.02
"""Share of a surface that is transparent from which it is said."""

_NAMED = 5
"""Parts of a mesh that are named."""


def with_unit(job: Job) -> Job:
    """A job whose unit is known, after what there is to say of its mesh. A usual size is taken, and said with
    the others that it could be; of another the unit is asked for at a terminal. Of a unit that was given, an
    unusual size is said. Raises InputError where nobody can be asked."""
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
        return job  # whoever reads it refuses it
    usual = taken is not None and SMALL_M < sizes[taken] < LARGE_M
    if taken is None or not (usual or standard):
        return replace(job, unit=_asked(job.mesh_path, sizes))
    if not standard:
        _note("the mesh gives no unit, and", taken, sizes)
    elif not usual:
        _note(f"a {job.mesh_path.suffix} file", taken, sizes)
    return replace(job, unit=taken)


def _say_of_parts(parts: tuple[str, ...]) -> None:
    """Of a file with several meshes: they may be several objects."""
    if len(parts) > 1:
        say(
            f"note: the file holds {len(parts)} meshes: {first_of(parts, _NAMED)}; they are taken as "
            "one object. Export several objects each by itself"
        )


def _say_of_clear(share: float) -> None:
    """Of a texture with holes, as a label's on a sheet of its own, and of glass."""
    if share > CLEAR:
        say(
            f"note: {100.0 * share:.0f} % of the surface is transparent; it is read as opaque there, in the "
            "colour that its texture or material has. Look at the sheet beside the reference model whether "
            "that is right; else cut these parts off, or fill the picture"
        )


def _say_of_origin(looked: Looked, unit: Unit) -> None:
    """Of a mesh in the coordinates of an assembly or of a scan."""
    if looked.away >= FAR * looked.diameter:
        say(
            f"note: the mesh's origin lies {length(looked.away * METRES[unit])} from the object; poses are "
            "those of that origin. For poses of the object itself move it there, and export the mesh again"
        )


def _warn_of(given: Unit, sizes: dict[Unit, float]) -> None:
    """Of a unit by which the mesh is smaller or larger than the objects that are usual, or than drawn scenes
    hold; one by which it is no object at all is refused by whoever reads it."""
    from huepose.scenes.rendered import LARGEST_M

    if given not in sizes or SMALL_M < sizes[given] <= LARGEST_M:
        return
    but = " or ".join(_size(sizes, unit) for unit in sizes if unit != given)
    text = f"its largest side is {length(sizes[given])} with --unit {given}"
    if sizes[given] > LARGEST_M:
        text += f": larger than drawn scenes hold ({length(LARGEST_M)})"
    say(f"warning: {text}{f'; it would be {but}' if but else ''}")


def _note(head: str, taken: Unit, sizes: dict[Unit, float]) -> None:
    """In which unit a mesh is read, and how large it would be in others."""
    others = [_size(sizes, unit) for unit in sizes if unit != taken]
    but = f" (it would be {', '.join(others)})" if others else ""
    side = f"its largest side is {length(sizes[taken])}{but}"
    say(f"note: {head} is read in {NAMES[taken]}: {side}. If that is wrong, give the unit with --unit.")


def _asked(path: Path, sizes: dict[Unit, float]) -> Unit:
    """The unit that the user names."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise InputError(
            path,
            found=f"no unit, and a largest side of {_in_words(sizes)}",
            expected="its unit: few objects have the size that metres or millimetres would give it",
            fix=f"Say it: --unit {'|'.join(sizes)}.",
        )
    say(f"{path} gives no unit. Its largest side is {_in_words(sizes)}.")
    while True:
        print(f"In which unit is it, {', '.join(sizes)}? ", end="", file=sys.stderr, flush=True)
        said = sys.stdin.readline()
        if not said:
            raise InputError(path, found="no answer", expected="its unit", fix="Say it with --unit.")
        for unit in sizes:
            if said.strip().lower() == unit:
                return unit


def _in_words(sizes: dict[Unit, float]) -> str:
    return ", ".join(_size(sizes, unit) for unit in sizes)


def _size(sizes: dict[Unit, float], unit: Unit) -> str:
    return f"{length(sizes[unit])} in {NAMES[unit]}"
