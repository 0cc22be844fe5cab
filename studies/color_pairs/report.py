"""The studies of colour pairs as tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from huepose.drawing.contact_sheet import contact_sheet
from huepose.drawing.plots import line_plot
from huepose.geometry.arrays import UInt8
from studies.color_pairs.changes import SERIES
from studies.color_pairs.icp_basin import Basin
from studies.color_pairs.repeatability import Repeated

PLOT_PX = (460, 330)


def repeatability_picture(rows: Sequence[Repeated]) -> UInt8:
    """One plot a change: found, known, known in its light, against the amount."""
    plots = []
    for series in SERIES:
        chosen = [r for r in rows if r.change == series.name]
        if not chosen:
            continue
        x = np.array([r.amount for r in chosen])
        lines = {
            "found": (x, np.array([r.found for r in chosen])),
            "known again": (x, np.array([r.known for r in chosen])),
            "known in its light": (x, np.array([r.known_in_its_light for r in chosen])),
        }
        plots.append(
            line_plot(
                lines, series.name, series.unit, "share of pairs", y_range=(0, 1.05), marks=True, size=PLOT_PX
            )
        )
    return contact_sheet(plots, 3)


def basin_picture(rows: Sequence[Basin]) -> UInt8:
    """Share of won starts against the turn and the shift, a line for each method."""
    plots = []
    for kind, label in (("turn", "turn, degrees"), ("shift", "shift, diameters")):
        lines = {}
        for method in dict.fromkeys(r.method for r in rows):
            chosen = [r for r in rows if r.method == method and r.kind == kind]
            lines[method] = (np.array([r.amount for r in chosen]), np.array([r.won for r in chosen]))
        plots.append(
            line_plot(lines, "starts won", label, "share", y_range=(0, 1.05), marks=True, size=(560, 420))
        )
    return contact_sheet(plots, 2)


def repeatability_lines(rows: Sequence[Repeated]) -> list[str]:
    """The table."""
    lines = [
        f"{'change':14s} {'amount':>7s} {'found':>6s} {'known':>6s} {'in its light':>12s}   % of the pairs"
    ]
    for r in rows:
        shares = (100 * r.found, 100 * r.known, 100 * r.known_in_its_light)
        lines.append("{:14s} {:7g} {:6.0f} {:6.0f} {:12.0f}".format(r.change, r.amount, *shares))
    return lines


def basin_lines(rows: Sequence[Basin]) -> list[str]:
    """The table: a row for each disturbance, a column for each method."""
    methods = list(dict.fromkeys(r.method for r in rows))
    won: Mapping[tuple[str, str, float], float] = {(r.method, r.kind, r.amount): r.won for r in rows}
    lines = [f"{'start':14s} " + " ".join(f"{m:>20s}" for m in methods) + "   % won"]
    for kind, amount in dict.fromkeys((r.kind, r.amount) for r in rows):
        start = f"turn {amount:g} deg" if kind == "turn" else f"shift {amount:g} d"
        lines.append(f"{start:14s} " + " ".join(f"{100 * won[m, kind, amount]:20.0f}" for m in methods))
    return lines
