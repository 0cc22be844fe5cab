"""`huepose eval calibration`: whether the quality of estimates is the share of them that is right."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from huepose.believe.quality import quality_fits
from huepose.drawing.plots import reliability_plot
from huepose.evaluation.calibration import Judged, Worth, read_judged, worth
from huepose.evaluation.result_files import result_names
from huepose.evaluation.summary import table
from huepose.support.files import write_picture
from huepose.support.words import known

HEADING = ("set", "n", "right %", "calibration error", "by chance", "found %", "over the level %",
           "right of them %")  # fmt: skip


def call(arguments: argparse.Namespace) -> int:
    """Read, compare, draw, print a table."""
    fit = quality_fits()[arguments.method]
    rows: list[list[Any]] = []
    for name, path in zip(result_names(arguments.results), arguments.results, strict=True):
        judged = read_judged(path)
        rows.append(worth_row(name, worth(judged.stated, judged, fit.level)))
        if arguments.plots is not None:
            _draw(arguments.plots, name, judged)
    print(f"{arguments.method}: level {fit.level:.3f}, found {fit.found:.3f}")
    print(table(HEADING, rows))
    return 0


def worth_row(name: str, worth: Worth) -> list[Any]:
    """A row under HEADING."""
    chance = "-" if worth.chance is None else "{:.3f} to {:.3f}".format(*worth.chance)
    precision = None if worth.precision is None else 100.0 * worth.precision
    right = 100.0 * worth.right / max(1, worth.poses)
    ece, found, over = known(worth.ece, ".3f"), 100.0 * worth.found, 100.0 * worth.coverage
    return [name, worth.poses, right, ece, chance, found, over, precision]


def _draw(folder: Path, name: str, judged: Judged) -> None:
    picture = reliability_plot(judged.stated, judged.right, title=f"quality and truth, {name}")
    write_picture(folder / f"reliability_{name}.png", picture)
