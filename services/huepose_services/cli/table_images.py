"""Single frames for `huepose eval tables`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from huepose import __version__
from huepose.datasets.ycb_objects import ycb_objects
from huepose.datasets.ycbv_folder import spread
from huepose.estimation import Estimator
from huepose.evaluation.estimate_protocol import EstimateOptions, EstimateSetup
from huepose.evaluation.tables.journal import Entry, Journal, models_digest, run_images
from huepose.evaluation.tables.submission import AsGiven, read_submission
from huepose.evaluation.targets import Targets, read_equivalents
from huepose.model import ReferenceModel
from huepose.perception.sessions import digest
from huepose.profiles import profile
from huepose.support.errors import InputError
from huepose_services.cli.evaluate_estimate import box_source
from huepose_services.cli.evaluate_scenes import bop_objects, open_ycbv_folder

METHODS = ("paper", "colorpair", "full")
"""The methods of this program; each has a column of its name."""


def images(
    arguments: argparse.Namespace,
    models: Mapping[str, ReferenceModel],
    path: Path,
    key: str,
    title: str,
    objects: Sequence[str] | None = None,
    named: Sequence[str] = (),
    equivalent: Path | None = None,
) -> tuple[dict[str, list[Entry]], list[str], dict[str, int]]:
    """Entries by method, notes on what they lack, and the number of labels in the whole set by object name.

    path: the data set, in a layout of YCB-Video; key: prefix of its files in OUT/runs; objects: names or
    ids, None for all; named: `NAME=FILE.csv` of other methods; equivalent: file of poses that count, too."""
    folder = open_ycbv_folder(path)
    scenes = folder.scenes if arguments.quick is None else spread(folder.scenes, arguments.quick)
    targets = Targets(models, objects)
    ids = [m.object_id for m in models.values() if m.object_id is not None]
    boxes, given = box_source(arguments.boxes)
    listed = bool(folder.coverage.targets)
    options = EstimateOptions(boxes, "auto", 0.0 if listed else 0.1, (arguments.seed,))
    equivalents = read_equivalents(equivalent) if equivalent else {}
    measured_on = bop_objects(folder.info, models) if folder.info is not None else {}
    submissions = [read_submission(one, set(ids)) for one in named]
    _check_names([submission.name for submission in submissions])
    # What results depend on: a journal with other settings is not continued.
    common = {name: getattr(arguments, name) for name in ("profile", "boxes", "seed", "objects")} | {
        "version": __version__,
        "models": models_digest(targets.models),
        "min_visib": options.min_visib,
        "boxes_file": digest(Path(arguments.boxes)) if given is not None else None,
        "equivalent": digest(equivalent) if equivalent else None,
    }
    entries = {}
    for method in arguments.methods:
        config = replace(profile(arguments.profile).estimator, method=method, threads=arguments.threads)
        estimator = Estimator({m.name: m for m in targets.models}, config)
        estimator.warm_up()
        setup = EstimateSetup(targets, estimator, options, equivalents, bop_objects=measured_on, given=given)
        journal = Journal(arguments.out / "runs" / f"{key}-{method}.jsonl", {**common, "method": method})
        entries[method] = run_images(journal, scenes, setup, f"{title}, {method}")
    for submission in submissions:
        setup = EstimateSetup(
            targets,
            AsGiven(),
            replace(options, boxes="file"),
            equivalents,
            bop_objects=measured_on,
            given=submission.poses,
        )
        file = arguments.out / "runs" / f"{key}-submission-{submission.name}.jsonl"
        file.unlink(missing_ok=True)  # it costs no estimation, and the CSV may have changed
        entries[submission.name] = run_images(Journal(file, common), scenes, setup, submission.name)
    n = sum(len(scene.image_ids) for scene in scenes)
    notes = [*folder.coverage.lines()]
    if n < sum(len(scene.image_ids) for scene in folder.scenes):
        notes.append(f"a sample of {n} images, spread evenly over the scenes")
    boxes_of = Path(arguments.boxes).name
    notes.append(f"boxes {boxes_of}, own masks, seed {arguments.seed}, profile {arguments.profile}")
    if not measured_on:
        notes.append("no models_info.json beside the data set's meshes: BOP's errors are not measured")
    if equivalents:
        notes.append(
            f"{len(equivalents)} labels have declared equivalents; they count in the rows that say so alone"
        )
    notes += [note for submission in submissions for note in submission.notes]
    notes += left_out(next(iter(entries.values())))
    all_names = {i: o.name for i, o in ycb_objects().items()} | {
        m.object_id: m.name for m in models.values() if m.object_id is not None
    }
    expected = {all_names.get(i, f"obj_{i:06d}"): n for i, n in folder.coverage.targets.items()}
    wanted = {m.name for m in targets.models}
    return entries, notes, {name: n for name, n in expected.items() if name in wanted}


def _check_names(submissions: Sequence[str]) -> None:
    """Raises InputError if a submission has the name of a method or of another submission."""
    for name in submissions:
        if name in METHODS or submissions.count(name) > 1:
            raise InputError(
                f"--submission {name}=FILE",
                found="one name for two columns",
                expected=f"a unique name, other than {', '.join(METHODS)}",
            )


def left_out(entries: Sequence[Entry]) -> list[str]:
    """Notes on labels and images that are not measured. One method's entries suffice: all read the same."""
    broken = [entry for entry in entries if "error" in entry]
    without = sum(entry.get("without_model", 0) for entry in entries)
    lines = [f"{without} labels of objects without a reference model are not measured"] if without else []
    if broken:
        reasons = "; ".join(str(entry["error"]) for entry in broken[:3])
        lines.append(f"{len(broken)} images or sequences could not be read: {reasons}")
    return lines
