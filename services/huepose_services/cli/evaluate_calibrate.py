"""`huepose eval calibrate`: fit quality to estimates with known truth, and say what it is worth on others."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.believe.quality import quality_fits
from huepose.datasets import files
from huepose.drawing.plots import reliability_plot
from huepose.evaluation import calibration
from huepose.evaluation.calibration import Worth
from huepose.evaluation.judged import NONE, Judged, read_absent, read_judged
from huepose.evaluation.result_files import write_json
from huepose.evaluation.summary import table
from huepose.geometry.arrays import Float64
from huepose.support.errors import InputError


def call(arguments: argparse.Namespace) -> int:
    """Fit where there are results to fit to, check, write, print."""
    checks = {path: read_judged(path) for path in arguments.check}
    rows: list[list[Any]] = []
    if arguments.results:
        labels = _all([read_judged(path) for path in arguments.results])
        others = _all([read_absent(path) for path in arguments.others])
        alike = _all([read_absent(path) for path in arguments.alike])
        sizes = _all([read_absent(path) for path in arguments.sizes])
        fitted = calibration.fit(labels, calibration.FEATURES[arguments.method], others, alike, sizes)
        fit, entry = fitted.fit, calibration.as_json(fitted.fit)
        for name, stated, judged, present in (
            ("fitted to, held out", fitted.labels, labels, fitted.present_labels),
            ("others, held out", fitted.others, others, fitted.present_others),
            ("other prints, held out", fitted.alike, alike, None),
            ("other sizes, held out", fitted.sizes, sizes, None),
        ):
            if len(judged.which):
                found = None if present is None else present >= fit.found
                rows.append(_row(name, calibration.worth(stated, judged, fit.level, found)))
        _draw(arguments.plots, "calibration", fitted.labels, labels)
        if arguments.out is not None:
            known = files.read_json(arguments.out) if arguments.out.exists() else {}
            write_json(arguments.out, {**known, arguments.method: entry})
        print(f"{arguments.method}: level {entry['level']:.3f}, found {entry['found']:.3f}")
    elif not checks:
        raise InputError("eval calibrate", found="no result", expected="RESULT.json, or --check RESULT.json")
    else:
        fit = quality_fits()[arguments.method]
    for path, judged in checks.items():
        stated = calibration.stated_by(fit, judged)
        rows.append(_row(path.stem, calibration.worth(stated, judged, fit.level)))
        _draw(arguments.plots, path.stem, stated, judged)
    heading = [
        "set",
        "n",
        "right %",
        "calibration error",
        "by chance",
        "found %",
        "over the level %",
        "right of them %",
    ]
    print(table(heading, rows))
    return 0


def _all(parts: Sequence[Judged]) -> Judged:
    return reduce(lambda a, b: a + b, parts, NONE)


def _row(name: str, worth: Worth) -> list[Any]:
    ece = "-" if worth.ece is None else f"{worth.ece:.3f}"
    precision = None if worth.precision is None else 100.0 * worth.precision
    right = 100.0 * worth.right / max(1, worth.poses)
    return [
        name,
        worth.poses,
        right,
        ece,
        chance_text(worth),
        100.0 * worth.found,
        100.0 * worth.coverage,
        precision,
    ]


def chance_text(worth: Worth) -> str:
    """What calibration error is by chance: on average, and at most in 95 % of draws."""
    return "-" if worth.chance is None else "{:.3f} to {:.3f}".format(*worth.chance)


def _draw(folder: Path | None, name: str, stated: Float64, judged: Judged) -> None:
    if folder is None:
        return
    picture = reliability_plot(stated, judged.right, title=f"quality and truth, {name}")
    path = folder / f"reliability_{name}.png"
    data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].tobytes()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    except OSError as error:
        raise InputError(path, found=error.strerror or str(error), fix="Choose another folder.") from None
