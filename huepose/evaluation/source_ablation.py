"""The ablation of single frames: what each source of poses brings to `paper` and `colorpair`, and costs.

Each variant is one of the two methods without one of its sources, or with one alone, asked the same
questions: triangles, point pair features, single pairs as frames, starts from shape, and the light that is
read from the pairs, which is no source but turns colours before all of them vote. `paper` has the first two.
`colorpair again` is the same method by other random numbers: what chance does, and so what a change must
exceed.

The folder of a run has VARIANT/SET.json, each as `huepose eval estimate` writes it, so that `huepose eval
compare` takes any two variants, and a journal, by which it is gone on with.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets import files
from huepose.datasets.types import Scene
from huepose.drawing.plots import bar_chart
from huepose.estimation.config import EstimatorConfig
from huepose.evaluation.bootstrap import Interval, Share, difference_intervals
from huepose.evaluation.estimate_protocol import EstimateSetup
from huepose.evaluation.measured import Measured, read_measured
from huepose.evaluation.result_files import origin, write_json
from huepose.evaluation.tables.journal import Journal
from huepose.geometry.arrays import UInt8
from huepose.paper.config import PaperConfig
from huepose.paper.extended.config import ColorpairPathConfig
from huepose.paper.extended.hypotheses import HypothesesConfig
from huepose.support.errors import InputError
from huepose.support.progress import progress

ALL = "all"
"""What all sets together are called."""

SOURCES = ("triangles", "ppf", "frames", "shape")
"""The parts of `HypothesesConfig` that propose poses, and the starts from shape."""

FIGURES = ("recall_add", "recall_adds", "auc_add", "auc_adds")


def variants(base: EstimatorConfig) -> dict[str, EstimatorConfig]:
    """Estimators by name, the first of each method without any change; base: what they have in common."""

    def paper(**off: Any) -> EstimatorConfig:
        return replace(base, method="paper", paper=PaperConfig(**off))

    def colorpair(*off: str) -> EstimatorConfig:
        votes: dict[str, Any] = dict.fromkeys(name for name in off if name != "shape")
        path = ColorpairPathConfig(hypotheses=HypothesesConfig(**votes))
        path = replace(path, shapes=0) if "shape" in off else path
        return replace(base, method="colorpair", colorpair=path)

    return {
        "paper": paper(),
        "paper-triangles-alone": paper(ppf=None),
        "paper-ppf-alone": paper(triangles=None),
        "colorpair": colorpair(),
        "colorpair-again": replace(colorpair(), seed=base.seed + 1),
        **{f"colorpair-without-{name}": colorpair(name) for name in (*SOURCES, "light")},
        **{f"colorpair-{name}-alone": colorpair(*(s for s in SOURCES if s != name)) for name in SOURCES},
    }


def run_variants(
    scenes: Sequence[Scene],
    setups: Mapping[str, EstimateSetup],
    folder: Path,
    name: str,
    settings: Mapping[str, Any],
) -> None:
    """Ask every variant all images of the set `name`, image by image in turn, so that what the machine does
    beside costs them alike; settings: what the results depend on. Raises InputError."""
    journals = {
        variant: Journal(folder / "journal" / f"{name}-{variant}.jsonl", {**settings, "variant": variant})
        for variant in setups
    }
    images = [(scene, image) for scene in scenes for image in scene.image_ids]
    for scene, image in progress(images, name):
        for variant, setup in setups.items():
            journal, key = journals[variant], f"{scene.name}/{image}"
            if journal.done(key):
                continue
            start = time.process_time()
            rows = [row.as_json() for row in setup.image(scene, image).rows]
            journal.add(key, {"rows": rows, "cpu_s": time.process_time() - start})
    for variant, journal in journals.items():
        entries = [journal.entries[f"{scene.name}/{image}"] for scene, image in images]
        rows = [row for entry in entries for row in entry["rows"]]
        cpu_ms = 1000.0 * sum(entry["cpu_s"] for entry in entries) / max(1, len(rows))
        summary = {**settings, "method": variant, "cpu_ms": cpu_ms}
        write_json(folder / variant / f"{name}.json", {"summary": summary, "rows": rows, "origin": origin()})


@dataclass(frozen=True)
class SourceRow:
    """A variant on a set of n questions. figures: in percent, by name; changes: of these against the whole
    method, None for that itself; intervals: of the changes, 95 %, over instances with all their boxes; won,
    lost: questions that became right and wrong; cpu_ms: a question, masks included."""

    name: str
    variant: str
    n: int
    figures: Mapping[str, float | None]
    changes: Mapping[str, float | None] | None
    intervals: Mapping[str, Interval | None] | None
    won: int
    lost: int
    cpu_ms: float


def source_rows(folder: Path) -> list[SourceRow]:
    """A row for each variant and each set in the folder of a run, and for all sets together. Raises
    InputError where there is none."""
    known = list(variants(EstimatorConfig()))
    names = sorted(path.stem for path in (folder / known[0]).glob("*.json"))
    sets = [(name, [name]) for name in names] + [(ALL, names)] * (len(names) > 1)
    read = {
        (variant, name): (
            read_measured(path := folder / variant / f"{name}.json"),
            files.read_json(path)["summary"]["cpu_ms"],
        )
        for variant in known
        for name in names
    }
    return [
        _row(title, variant, [read[variant, n] for n in own], [read[variant.split("-")[0], n] for n in own])
        for title, own in sets
        for variant in known
    ]


def _row(
    title: str,
    variant: str,
    parts: Sequence[tuple[Measured, float]],
    whole: Sequence[tuple[Measured, float]],
) -> SourceRow:
    """Of the files of a variant, beside those of its whole method in the same order of questions."""
    measured = [part for part, _ in parts]
    if [m.keys for m in measured] != [m.keys for m, _ in whole]:
        raise InputError(
            f"{variant}, {title}",
            found="other questions than those of the whole method",
            fix="Measure the set again in another folder of --runs.",
        )
    after = {key: _joined(measured, key) for key in FIGURES}
    before = {key: _joined([m for m, _ in whole], key) for key in FIGURES}
    units = [(m.path.stem, unit) for m in measured for unit in m.units]
    pairs = {key: (before[key], after[key]) for key in FIGURES}
    steps = np.sign(after["recall_add"].part - before["recall_add"].part)
    n = len(units)
    is_whole = "-" not in variant
    return SourceRow(
        title,
        variant,
        n,
        {key: share.value for key, share in after.items()},
        None if is_whole else {k: (b.value or 0.0) - (a.value or 0.0) for k, (a, b) in pairs.items()},
        None if is_whole else difference_intervals(pairs, units),
        int((steps > 0).sum()),
        int((steps < 0).sum()),
        sum(ms * len(m.rows) for m, ms in parts) / n,
    )


def _joined(parts: Sequence[Measured], key: str) -> Share:
    shares = [part.shares[key] for part in parts]
    return Share(np.concatenate([s.part for s in shares]), np.concatenate([s.whole for s in shares]))


def picture(rows: Sequence[SourceRow], key: str = "recall_add", label: str = "recall of ADD in %") -> UInt8:
    """Bars of a figure by set, a panel each for what is left without a source, for each source alone, and for
    the paper's method; the place at the right is the legend's."""
    groups = list(dict.fromkeys(row.name for row in rows))
    values = {(row.name, row.variant): row.figures[key] for row in rows}
    panels = []
    for method, kind in (("colorpair", "without"), ("colorpair", "alone"), ("paper", "alone")):
        shown = [
            v for v in variants(EstimatorConfig()) if v == method or (v.startswith(method) and kind in v)
        ]
        series = {
            v.removeprefix(f"{method}-").replace("-", " "): [
                *(np.nan if (value := values[group, v]) is None else value for group in groups),
                np.nan,
            ]
            for v in shown
        }
        title = f"{method}, {'without one source' if kind == 'without' else 'one source alone'}: {label}"
        panels.append(bar_chart([*groups, ""], series, title, "", (0.0, 118.0), (1480, 340)))
    return np.vstack(panels)
