"""`huepose onboard` and `huepose onboard-bop`: make reference models from meshes."""

from __future__ import annotations

import argparse
import hashlib
import os
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.files import write_picture
from huepose.support.progress import Status, progress
from huepose.support.words import counted
from huepose_services.cli.mesh_unit import with_unit
from huepose_services.cli.onboard_video import add_video, mesh_from_video
from huepose_services.cli.options import (
    add_json,
    add_number,
    add_path,
    add_several,
    add_unit,
    from_one,
    print_result,
    say,
)

if TYPE_CHECKING:
    from huepose.onboarding.batch import Job, Onboarded
    from huepose.onboarding.bop_folder import BopModel


def add_parser(subparsers: Any) -> None:
    one = subparsers.add_parser(
        "onboard",
        help="make a reference model from a textured mesh, or from a recording of the object",
        description="Make a reference model from a textured mesh (OBJ, PLY, GLB or glTF), or with "
        "--from-video from an RGB-D recording in which the object turns before a fixed camera.",
    )
    one.add_argument("mesh", type=Path, nargs="?", metavar="MESH", help="mesh file")
    add_video(one)
    one.add_argument("--name", required=True, help="the object's name: 1 to 64 of a-z, 0-9, _ and -")
    one.add_argument("--id", type=int, metavar="N", help="the object's number in a BOP data set")
    add_unit(one)
    add_symmetric(one)
    _paper(one)
    add_test(one)
    add_json(one)
    add_path(one, "--out", "BUNDLES", "folder of reference models", required=True)
    one.set_defaults(call=call)

    many = subparsers.add_parser(
        "onboard-bop",
        help="make reference models from a BOP models folder",
        description="Make reference models from a BOP models folder (obj_NNNNNN.ply or .obj, millimetres).",
    )
    many.add_argument("models_dir", type=Path, metavar="MODELS_DIR", help="BOP models folder")
    add_path(many, "--out", "BUNDLES", "folder of reference models", required=True)
    add_several(many, "--ids", "N", "only these objects", kind=int)
    _paper(many)
    add_number(many, "--processes", 2, "worker processes (2)", kind=from_one)
    many.set_defaults(call=call_bop)


def add_symmetric(parser: argparse.ArgumentParser) -> None:
    """Add the option that says which rotations do not matter."""
    parser.add_argument(
        "--symmetric",
        metavar="x|y|z|FILE",
        help="the rotation about this axis of the mesh does not matter if it keeps the shape; or a "
        "JSON file with symmetries_discrete and symmetries_continuous as in BOP's "
        "models_info.json, millimetres. Default: the symmetries of shape and texture together",
    )


def add_test(parser: argparse.ArgumentParser) -> None:
    """Add the option that skips the self-test."""
    parser.add_argument(
        "--no-test",
        dest="test",
        action="store_false",
        help="skip the self-test in rendered scenes, which says how well the object suits (half a minute)",
    )


def _paper(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--paper",
        action="store_true",
        help="add the tables of the paper's method, for --method paper and --method colorpair",
    )


def call(arguments: argparse.Namespace) -> int:
    """Onboard one object; exit code 1 if a recording showed too little of it."""
    from huepose.onboarding.batch import Job
    from huepose.onboarding.declared import symmetries_of

    check_folder(arguments.out)
    symmetric = symmetries_of(arguments.symmetric)
    made = mesh_from_video(arguments)
    mesh, unit = arguments.mesh, arguments.unit
    if made:
        mesh, unit = made.mesh, "m"
    job = Job(mesh, arguments.name, arguments.id, unit, symmetric=symmetric, paper=arguments.paper)
    result = onboard_one(job, arguments.out, unit_known=made is not None)
    if not arguments.json:
        print(in_words(result), flush=True)
        if made:
            print(made.words, flush=True)
    part = None if made is None or made.facts["all_round"] else made.facts["surface"]
    found, words = self_test(arguments.out, arguments.name, part) if arguments.test else (None, "")
    answer = {**asdict(result), "path": str(result.path), "suitability": found}
    if made:
        answer["video"] = made.facts
    if arguments.json or words:
        print_result(arguments, answer, words)
    return 0 if part is None else 1


def self_test(bundles: Path, name: str, part: float | None = None) -> tuple[dict[str, Any] | None, str]:
    """Test in rendered scenes how well an object suits. Returns the result for programs and in words; draws
    it to BUNDLES/NAME.verdict.png, and keeps the verdict beside the model.

    part: share of the surface that a recording showed, None for a model of all of it."""
    from huepose.evaluation import suitability
    from huepose.model import load_models
    from huepose_services.models import keep_verdict, sheet_path

    model = load_models(bundles, [name])[name]
    try:
        found = suitability.self_test(model)
        if part is not None:
            found = suitability.seen_in_part(found, part)
    except InputError as error:
        say(f"{name} was not tested in rendered scenes: {error}")
        return None, ""
    picture = sheet_path(bundles, name)
    write_picture(picture, suitability.sheet(model, found))
    facts = {
        key: getattr(found, key)
        for key in ("verdict", "right", "tracking", "false_tracking", "turned", "smallest_px", "reasons")
    }
    said = suitability.in_words(model, found)
    keep_verdict(bundles, model, found.verdict, said.splitlines()[0])
    words = f"{said}\nThe test scenes and their results: {picture}"
    return {**facts, "trials": len(found.trials), "image": str(picture)}, words


def onboard_one(job: Job, out: Path, unit_known: bool = False) -> Onboarded:
    """Onboard a mesh into a folder of reference models, with a progress bar. Prints a note if it replaced
    another model of that name. unit_known: the job has its unit, which is not checked."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only cost
    from huepose.model.io import check_name, model_path
    from huepose.onboarding import batch
    from huepose.onboarding.reference import STAGES

    check_name(job.name)
    check_folder(out)
    if not job.mesh_path.exists():
        raise InputError(job.mesh_path, found="no such file", expected="the mesh", fix="Check the path.")
    job = job if unit_known else with_unit(job)
    before = _model_there(model_path(out, job.name))
    with closing(progress(range(len(STAGES) + 1), f"onboarding {job.name}")) as steps:
        result = batch.onboard_one(job, out, lambda stage: _advance(steps), Status().line)
        deque(steps, maxlen=0)
    _report_notes(result, before, "onboard that object again under another --name")
    return result


def _model_there(path: Path) -> tuple[str, str] | None:
    """Digest and date, in words, of a model file before onboarding; None if there is none."""
    if not path.is_file():
        return None
    return _digest(path), f"{datetime.fromtimestamp(path.stat().st_mtime):%Y-%m-%d at %H:%M}"


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _report_notes(result: Onboarded, before: tuple[str, str] | None, to_have_both: str) -> None:
    """Print notes about the mesh. If its model replaced another, say so, and remove the other's verdict."""
    from huepose_services.models import forget_verdict

    for note in result.notes:
        Status().line(f"note: {result.name}: {note}")
    if before is None or before[0] == _digest(result.path):
        return
    forget_verdict(result.path.parent, result.name)
    Status().line(
        f"note: {result.path} replaced another reference model named {result.name}, made on "
        f"{before[1]}. To have both, {to_have_both}"
    )


def call_bop(arguments: argparse.Namespace) -> int:
    """Onboard a folder; an object that fails is reported, and the others are still onboarded."""
    from huepose.onboarding.bop_folder import bop_models, other_meshes

    check_folder(arguments.out)
    models = bop_models(arguments.models_dir, arguments.ids)
    if others := other_meshes(arguments.models_dir):
        say(f"note: not onboarded, because the name is not obj_NNNNNN.ply or .obj: {', '.join(others)}")
    failed = onboard_models(models, arguments.out, arguments.paper, arguments.processes)
    if failed:
        names = ", ".join(failed)
        say(f"huepose onboard-bop: {len(failed)} of {len(models)} failed: {names}")
        return 2
    return 0


def onboard_models(models: Sequence[BopModel], out: Path, paper: bool, processes: int) -> list[str]:
    """Onboard models, print the result of each, and return the names of those that failed."""
    from huepose.model.io import model_path
    from huepose.onboarding.batch import Job, Onboarded, StageBegun, onboard_many
    from huepose.onboarding.reference import STAGES

    before = {m.name: _model_there(model_path(out, m.name)) for m in models}
    jobs = [
        Job(m.mesh_path, m.name, m.object_id, "mm", info=m.info, frame_offset_m=m.frame_offset_m, paper=paper)
        for m in models
    ]
    failures, what = [], f"onboarding {counted(len(jobs), 'object')}"
    with (
        closing(onboard_many(jobs, out, max(1, min(processes, len(jobs))))) as events,
        closing(progress(range(len(jobs) * (len(STAGES) + 1)), what)) as steps,
    ):
        for event in events:
            if isinstance(event, Onboarded):
                _say(in_words(event))
                _report_notes(event, before[event.name], "onboard these into another folder, --out")
            elif not isinstance(event, StageBegun):
                failures.append(event.name)
                _say(f"{event.name:28s} failed: {event.reason}")
            _advance(steps)
        deque(steps, maxlen=0)
    return failures


def check_folder(out: Path) -> None:
    """Raises InputError if the output folder is a file; called before the work."""
    if out.exists() and not out.is_dir():
        raise InputError(out, found="a file", expected="a folder, which may be new")


def _advance(steps: Iterator[int]) -> None:
    next(steps, None)


def _say(line: str) -> None:
    Status().clear()  # clears the progress bar
    print(line, flush=True)


def in_words(result: Onboarded) -> str:
    """A line about the reference model that was made."""
    size = " x ".join(f"{s * 100:.1f}" for s in result.size_m)
    shape = f"{result.equivalents} rotations look the same; " if result.equivalents > 1 else ""
    if result.paper:
        shape += "with the paper's tables; "
    return (
        f"{result.name:28s} {size} cm, diameter {result.diameter_m * 100:.1f} cm; {shape}"
        f"{result.file_bytes / 1e6:.1f} MB, {result.seconds:.1f} s"
    )
