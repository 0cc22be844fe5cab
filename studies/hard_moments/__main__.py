"""Hard moments for the tracker.

    .venv/bin/python -m studies.hard_moments --json FILE [--plots DIR]

Draws each moment with the project's own renderer at first use (kept under the cache folder), plays it to a
new tracker with late perception, and says for all of them: coverage, false TRACKING, how soon a loss is
declared, how soon an object is back, and how well the stated quality agrees with the share that is right.
Perception is an oracle with small errors, which also gives the first poses; with `--perception estimate` it
is the project's own estimator, which has to find the objects first.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from huepose.datasets.types import VISIBLE
from huepose.drawing.canvas import FONT, INK, Colour
from huepose.drawing.plots import reliability_plot
from huepose.evaluation import metrics
from huepose.evaluation.result_files import write_json
from huepose.evaluation.states import StateReport, combined, report
from huepose.evaluation.summary import table
from huepose.geometry.arrays import UInt8
from huepose.model import ReferenceModel
from huepose.support.files import cache_folder, write_picture
from huepose.tracking import Tracker
from studies.hard_moments.film import Film
from studies.hard_moments.perception import Oracle, OwnEstimates
from studies.hard_moments.play import Played, Told, play
from studies.hard_moments.scripts import MOMENTS, meshes
from studies.hard_moments.traps import TRAPS
from studies.stress.objects import learned

COLOURS: Mapping[str, Colour] = {
    "TRACKING, right": (70, 170, 90),
    "TRACKING, wrong": (220, 40, 40),
    "SUSPECT, right": (240, 205, 90),
    "SUSPECT, wrong": (235, 150, 50),
    "no pose": (120, 120, 130),
}
HIDDEN: Colour = (40, 60, 120)
LEFT_PX, WIDTH_PX, ROW_PX = 250, 760, 26


def meaning(told: Told) -> str:
    """Which band a frame belongs to."""
    if told.pose is None or told.pose.T_cam_obj is None or told.state is None:
        return "no pose"
    return f"{told.state}, {'right' if told.right else 'wrong'}"


def bands(rows: Sequence[tuple[str, Sequence[Told]]], title: str) -> UInt8:
    """A picture (H, W, 3): a row for each object of each moment, time to the right; the dark line under a
    band says how much of the object is hidden."""
    height = 70 + ROW_PX * len(rows)
    page: UInt8 = np.full((height, LEFT_PX + WIDTH_PX + 20, 3), 255, np.uint8)
    cv2.putText(page, title, (12, 24), FONT, 0.6, INK, 1, cv2.LINE_AA)
    x = 12
    for name, colour in {**COLOURS, "share hidden": HIDDEN}.items():
        cv2.rectangle(page, (x, 36), (x + 14, 48), colour, -1)
        cv2.putText(page, name, (x + 19, 47), FONT, 0.42, INK, 1, cv2.LINE_AA)
        x += 150
    for r, (name, told) in enumerate(rows):
        top = 62 + ROW_PX * r
        cv2.putText(page, name, (12, top + 14), FONT, 0.42, INK, 1, cv2.LINE_AA)
        edges = LEFT_PX + np.rint(np.linspace(0, WIDTH_PX, len(told) + 1)).astype(int)
        for t, left, right in zip(told, edges[:-1], edges[1:], strict=True):
            page[top : top + 15, left:right] = COLOURS[meaning(t)]
            hidden = round(6 * (1.0 - min(t.visib_fract, 1.0)))
            page[top + 16 : top + 16 + hidden, left:right] = HIDDEN
    return page


ALL = {**MOMENTS, **TRAPS}
PERCEPTION: dict[str, type[Oracle] | type[OwnEstimates]] = {"oracle": Oracle, "estimate": OwnEstimates}

STATES = {
    "coverage_tracking": "coverage %",
    "false_tracking_frames": "false",
    "declared_suspect_after_frames": "SUSPECT after",
    "declared_lost_after_frames": "LOST after",
    "undeclared_losses": "undeclared",
    "reacquired_after_s": "back after s",
    "never_reacquired": "never back",
}


def figures(played: Played, states: StateReport) -> dict[str, object]:
    """One line of the table."""
    errors = [t for own in played.told for t in own if t.visib_fract >= VISIBLE]
    add = [t.add_m for t in errors]
    return {
        **{key: getattr(states, key) for key in STATES},
        "false_tracking_rate": states.false_tracking_rate,
        "frames": states.frames,
        "auc_add": metrics.auc(np.array(add)),
        "add_mm_p50": 1e3 * float(np.median(add)),
        "cpu_ms_p50": 1e3 * float(np.median(played.cpu_s)),
        "cpu_ms_p99": 1e3 * float(np.percentile(played.cpu_s, 99)),
    }


def main() -> int:
    """Play, write, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--plots", type=Path, default=None, help="folder for the pictures")
    parser.add_argument("--only", nargs="*", default=list(ALL), choices=list(ALL))
    parser.add_argument("--perception", choices=list(PERCEPTION), default="oracle")
    parser.add_argument(
        "--seed", type=int, nargs="+", default=[0], help="of the errors of late poses, or boxes"
    )
    parser.add_argument("--cache", type=Path, default=cache_folder() / "moments")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    known = learned(meshes(), arguments.cache)
    rows: list[tuple[str, list[Told]]] = []
    reports: list[StateReport] = []
    lines: dict[str, dict[str, object]] = {}
    for name in arguments.only:
        film = Film(ALL[name](), arguments.cache)
        for seed in arguments.seed:
            perception = PERCEPTION[arguments.perception](film.script, known, seed)
            played = play(film, known, _tracker(film, known), perception=perception)
            own = [report([t.moment() for t in told]) for told in played.told]
            reports += own
            label = film.script.name + (f", seed {seed}" if len(arguments.seed) > 1 else "")
            lines[label] = figures(played, combined(own))
            rows += [(label, told) for told in played.told]
    hard = combined(reports)
    every = [t for _, told in rows for t in told if t.pose is not None and t.pose.T_cam_obj is not None]
    quality, right = np.array([t.quality for t in every]), np.array([t.right for t in every])
    ece = metrics.expected_calibration_error(quality, right)
    over_all = {key: getattr(hard, key) for key in (*STATES, "false_tracking_rate", "frames")}
    write_json(arguments.json, {"summary": {"ece": ece, "moments": lines, **over_all}})
    if arguments.plots is not None and every:
        write_picture(arguments.plots / "moments.png", bands(rows, "hard moments, frame by frame"))
        write_picture(arguments.plots / "reliability.png", reliability_plot(quality, right, title="tracking"))
    print(_report(lines, hard, ece))
    return 0


def _tracker(film: Film, known: dict[str, ReferenceModel]) -> Tracker:
    tracker = Tracker({name: known[name] for name in dict.fromkeys(film.script.objects)})
    tracker.warm_up()
    return tracker


def _report(lines: dict[str, dict[str, object]], hard: StateReport, ece: float | None) -> str:
    columns = {
        **STATES,
        "auc_add": "AUC",
        "add_mm_p50": "mm p50",
        "cpu_ms_p50": "ms p50",
        "cpu_ms_p99": "p99",
    }
    rows = [[name, *(line[key] for key in columns)] for name, line in lines.items()]
    text = table(["moment", *columns.values()], rows)
    coverage = "-" if hard.coverage_tracking is None else f"{hard.coverage_tracking:.1f} %"
    return (
        f"{text}\nall hard moments: TRACKING in {coverage} of visible frames, false TRACKING "
        f"{hard.false_tracking_rate:.2f} %, SUSPECT after {hard.declared_suspect_after_frames}, LOST after "
        f"{hard.declared_lost_after_frames} frames, undeclared {hard.undeclared_losses}; back after "
        f"{hard.reacquired_after_s} s at most, never {hard.never_reacquired}; calibration error {ece:.3f}"
    )


if __name__ == "__main__":
    sys.exit(main())
