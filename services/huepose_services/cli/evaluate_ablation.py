"""`huepose eval ablation`: what filtering flow by colour pairs does to the motion computed from it; of single
frames, what each source of poses brings to the methods `paper` and `colorpair`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from huepose.datasets.ycbv_folder import spread
from huepose.estimation import Estimator
from huepose.evaluation.ablation import evaluate_ablation, with_networks
from huepose.evaluation.estimate_protocol import EstimateOptions, EstimateSetup
from huepose.evaluation.result_files import origin, write_json
from huepose.evaluation.source_ablation import SourceRow, picture, run_variants, source_rows, variants
from huepose.evaluation.summary import table
from huepose.evaluation.targets import Targets, read_equivalents
from huepose.model import load_models
from huepose.profiles import profile
from huepose.support.errors import InputError
from huepose.support.files import write_picture
from huepose_services.cli.evaluate_scenes import open_bop, open_fast_ycb, shown

COLUMNS = {
    "rotation_error_rel_median": "rotation",
    "rotation_error_rel_mean": "(mean)",
    "translation_error_rel_median": "translation",
    "translation_error_rel_mean": "(mean)",
    "epe_px_median": "EPE px",
    "matches_median": "matches",
    "no_motion": "none",
}


def call(arguments: argparse.Namespace) -> int:
    """Compare, write, draw, print a table."""
    if arguments.bop:
        return _of_sources(arguments)
    import cv2

    cv2.setNumThreads(1)  # as the tracker's worker does
    scenes, models = open_fast_ycb(arguments.fast_ycb, arguments.bundles)
    result = evaluate_ablation(scenes, Targets(models), arguments.gap, with_networks())
    record = result.as_json()
    write_json(arguments.json, record)
    if arguments.plots is not None:
        write_picture(arguments.plots / "ablation.png", result.picture())
    print(_report(record["summary"]))
    return 0


def _report(summary: dict[str, Any]) -> str:
    rows = [
        [name, *(_shown(block[key], key) for key in COLUMNS)] for name, block in summary["variants"].items()
    ]
    return "\n".join(
        [
            table(["variant", *COLUMNS.values()], rows),
            f"{summary['pairs']} pairs of frames {summary['gap']} apart, {summary['pairs_left_out']} left "
            "out because they hardly move; medians, errors as shares of the true motion",
        ]
    )


def _shown(value: float | None, key: str) -> str:
    if value is None:
        return "-"
    return f"{value:.0f}" if key in ("matches_median", "no_motion") else f"{value:.3f}"


_COLUMNS = {"recall_add": "ADD", "recall_adds": "ADD-S", "auc_add": "AUC ADD"}


def _of_sources(arguments: argparse.Namespace) -> int:
    """Measure the set, then tell what all sets in the folder say."""
    if arguments.runs is None:
        raise InputError("--bop", found="no --runs", expected="--runs DIR, the folder of the variants")
    models = load_models(arguments.bundles)
    scenes = open_bop(arguments.bop)
    targets = Targets(models)
    options = EstimateOptions(min_visib=0.1, seeds=tuple(arguments.seed))
    equivalents = read_equivalents(arguments.equivalent) if arguments.equivalent else {}
    setups = {}
    for name, config in variants(profile("live").estimator).items():
        estimator = Estimator(models, config)
        estimator.warm_up(shown(scenes, targets))
        setups[name] = EstimateSetup(targets, estimator, options, equivalents)
    run_variants(
        scenes if arguments.quick is None else spread(scenes, arguments.quick),
        setups,
        arguments.runs,
        arguments.set or arguments.bop[0].resolve().parent.name,
        {"profile": "live", "boxes": options.boxes, "masks": options.masks, "seed": list(arguments.seed)},
    )
    rows = source_rows(arguments.runs)
    write_json(arguments.json, {"rows": [asdict(row) for row in rows], "origin": origin()})
    if arguments.plots is not None:
        write_picture(arguments.plots / "sources.png", picture(rows))
    print(_sources_report(rows))
    return 0


def _sources_report(rows: Sequence[SourceRow]) -> str:
    heading = ["set", "variant", "n", "ADD", "ADD-S", "AUC ADD", *(f"{c}, change" for c in _COLUMNS.values())]
    cells = [
        [
            row.name,
            row.variant.replace("-", " "),
            row.n,
            *(row.figures[key] for key in _COLUMNS),
            *(_change(row, key) for key in _COLUMNS),
            f"{row.won} / {row.lost}",
            f"{row.cpu_ms:.0f}",
        ]
        for row in rows
    ]
    return "\n".join(
        [
            table([*heading, "won / lost", "CPU ms"], cells),
            "changes against the whole method, with 95 % intervals over instances with all their boxes; CPU "
            "of a question, masks included",
        ]
    )


def _change(row: SourceRow, key: str) -> str:
    if row.changes is None or row.intervals is None or (change := row.changes[key]) is None:
        return "-"
    span = row.intervals[key]
    return f"{change:+.1f}" if span is None else f"{change:+.1f} ({span[0]:+.1f} to {span[1]:+.1f})"
