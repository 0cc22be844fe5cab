"""Track under stress, and report how often the states were right, by cause.

    .venv/bin/python -m studies.stress --out OUT --split report --films 60 --processes 2
    .venv/bin/python -m studies.stress --out OUT --split report --films 24 --objects unseen
    .venv/bin/python -m studies.stress --out OUT --split report --films 40 --bundles BUNDLES
    .venv/bin/python -m studies.stress --out OUT --fast-ycb SEQ... --bundles BUNDLES

Films of two seconds are rendered (about 12 s of CPU each) and kept in the cache folder: an object is carried
fast, leaves the image and comes back, is swapped for its look-alike, or slides on a plain ground with one
face up until it is picked up. With `--kind "put away"` films have four seconds, and the object leaves and
comes back at the speed of a hand. The objects are twelve procedural ones, among them plain parts, boxes with
plain sides and a can with repeated labels; with `--objects household` random bowls, mugs, tools, fruit and
packages; with `--objects unseen` objects to which nothing is fitted; with `--bundles` the reference models of
that folder that belong to the split. Recorded sequences are played for the causes that need no rendering.
Each film is played with every cause (`studies.stress.causes`), `alone` and `with_loop`: then a nearly perfect
perception answers at 5 Hz after 0.35 s.

Results stay in OUT/rows.jsonl; the same command continues an interrupted run. The report is on the films of
the command, whatever else is in OUT. Each split has its own seed and objects: parameters that were fitted on
`fit` and chosen on `choose` are reported on `report`.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from huepose.evaluation.result_files import write_json
from huepose.evaluation.tables.figures import rows_of
from huepose.evaluation.tables.journal import Journal
from huepose.support.progress import progress
from studies.stress.playing import KINDS, MODES, OBJECTS, SPLITS, Job, asked_for, missing, models_of, played
from studies.stress.report import summary, text


def main() -> None:
    """Play the missing films, report on all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--split", choices=list(SPLITS), default="report")
    parser.add_argument("--films", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="number of the first film")
    parser.add_argument("--objects", choices=list(OBJECTS), default="builtin")
    parser.add_argument("--bundles", type=Path, default=None)
    parser.add_argument("--fast-ycb", type=Path, nargs="+", default=[])
    parser.add_argument("--kind", choices=[*dict.fromkeys(KINDS), "put away"], help="default: all by turns")
    parser.add_argument("--modes", nargs="+", choices=MODES, default=list(MODES))
    parser.add_argument("--processes", type=int, default=1)
    arguments = parser.parse_args()
    modes = tuple(arguments.modes)
    objects = arguments.objects if arguments.bundles is None else arguments.bundles
    jobs = [Job(arguments.split, 0, objects, path, modes) for path in arguments.fast_ycb]
    if not jobs:
        numbers = range(arguments.first, arguments.first + arguments.films)
        jobs = [Job(arguments.split, n, objects, None, modes, arguments.kind) for n in numbers]
        models_of(arguments.split, objects)
    journal = Journal(arguments.out / "rows.jsonl", {})
    with ProcessPoolExecutor(arguments.processes, get_context("spawn")) as pool:
        left = missing(jobs, rows_of([*journal.entries.values()]))
        tasks = {pool.submit(played, job): job for job in left}
        for task in progress(as_completed(tasks), "films", len(tasks)):
            job = tasks[task]
            journal.add(f"{job.name}, {' and '.join(job.modes)}", {"rows": task.result()})
    rows = asked_for(jobs, rows_of([*journal.entries.values()]))
    result = summary([row for row in rows if row["frames"]])
    write_json(arguments.out / "summary.json", result)
    print(text(result))


if __name__ == "__main__":
    main()
