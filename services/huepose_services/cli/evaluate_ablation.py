"""`huepose eval ablation`: how filtering optical flow by colour pairs changes the computed motion."""

from __future__ import annotations

import argparse
from typing import Any

from huepose.evaluation.ablation import evaluate_ablation, with_networks
from huepose.evaluation.result_files import write_json
from huepose.evaluation.summary import table
from huepose.evaluation.targets import Targets
from huepose.support.files import write_picture
from huepose.support.words import known
from huepose_services.cli.evaluate_scenes import open_fast_ycb

COLUMNS = {
    "rotation_error_rel_median": "rotation",
    "rotation_error_rel_mean": "(mean)",
    "translation_error_rel_median": "translation",
    "translation_error_rel_mean": "(mean)",
    "epe_px_median": "EPE px",
    "matches_median": "matches",
    "no_motion": "none",
}
_COUNTS = ("matches_median", "no_motion")


def call(arguments: argparse.Namespace) -> int:
    """Compare, print a table, write JSON and a plot."""
    import cv2

    cv2.setNumThreads(1)  # as the tracker's worker does
    scenes, models = open_fast_ycb(arguments.fast_ycb, arguments.bundles)
    result = evaluate_ablation(scenes, Targets(models), with_networks())
    record = result.as_json()
    print(_report(record["summary"]))
    write_json(arguments.json, record)
    if arguments.plots is not None:
        write_picture(arguments.plots / "ablation.png", result.picture())
    return 0


def _report(summary: dict[str, Any]) -> str:
    rows = [
        [name, *(known(block[key], ".0f" if key in _COUNTS else ".3f") for key in COLUMNS)]
        for name, block in summary["variants"].items()
    ]
    return "\n".join(
        [
            table(["variant", *COLUMNS.values()], rows),
            f"{summary['pairs']} pairs of frames {summary['gap']} apart, {summary['pairs_left_out']} left "
            "out because they hardly move; medians, errors as shares of the true motion",
        ]
    )
