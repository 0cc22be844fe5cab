"""What the demo shows: a live table, drawn over itself four times a second, and the figures at the end."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, TextIO

from huepose_services.demo.score import Latest

_PERIOD_S = 0.25
_COLOURS = {"TRACKING": "32", "SUSPECT": "33", "LOST": "31", "SEARCHING": "90"}


class Table:
    """One line an object: state, error against the truth, rate, age."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._colour = out.isatty()
        self._next = 0.0
        self._lines = 0

    def show(self, rows: Mapping[str, Latest], last_ns: int) -> None:
        """Draw, if it is time."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + (_PERIOD_S if self._colour else 5.0)
        lines = [f"{'object':24s} {'state':10s} {'error mm':>9s} {'rate Hz':>8s} {'age ms':>7s}"]
        lines += [self._line(name, row) for name, row in rows.items()]
        if self._colour and self._lines:
            self._out.write(f"\x1b[{self._lines}A")
        end = "\x1b[K\n" if self._colour else "\n"
        self._out.write("".join(line + end for line in lines))
        self._out.flush()
        self._lines = len(lines)

    def _line(self, name: str, row: Latest) -> str:
        error = "-" if row.error_m is None else f"{row.error_m * 1000.0:.1f}"
        age = "-" if row.age_ms is None else f"{row.age_ms:.0f}"
        state = f"{row.state:10s}"
        if self._colour:
            state = f"\x1b[{_COLOURS[row.state]}m{state}\x1b[0m"
        return f"{name:24s} {state} {error:>9s} {row.rate_hz:>8.0f} {age:>7s}"


def report(result: Mapping[str, Any]) -> str:
    """The end of a demo for people: per object, in total, and what each worker took."""
    summary = result["summary"]
    head = ("object", "acquired s", "confirmed s", "ADD recall %", "median mm", "TRACKING %", "false")
    lines = ["", "{:24s} {:>11s} {:>12s} {:>13s} {:>10s} {:>11s} {:>6s}".format(*head)]
    row = "{:24s} {:>11s} {:>12s} {:>13s} {:>10s} {:>11s} {:>6d}"
    for name, figures in [*summary["per_object"].items(), ("all (times: the largest)", summary)]:
        lines.append(
            row.format(
                name,
                _figure(figures["acquired_after_s"], 2),
                _figure(figures["confirmed_after_s"], 2),
                _figure(figures["recall_add"], 1),
                _figure(figures.get("add_mm_p50"), 2),
                _figure(figures["coverage_tracking"], 1),
                figures["false_tracking_frames"],
            )
        )
    lines += [
        "",
        f"capture to pose {_figure(summary['latency_ms_p50'], 1)} ms "
        f"(p99 {_figure(summary['latency_ms_p99'], 1)}) over {summary['frames']} frames, "
        f"{summary['objects']} objects; AUC ADD {_figure(summary['auc_add'], 1)}, "
        f"ADD-S recall {_figure(summary['recall_adds'], 1)} %",
        "",
        f"{'worker':12s} {'CPU %':>7s} {'MiB':>6s} {'rate Hz':>8s} {'work ms p50':>12s} {'p99':>7s}",
    ]
    for name, worker in result["workers"].items():
        p50, p99 = worker["work_ms"] or (None, None)
        lines.append(
            f"{name:12s} {worker['cpu_percent']:7.0f} {worker['memory_mib']:6d} {worker['rate_hz']:8.1f} "
            f"{_figure(p50, 1):>12s} {_figure(p99, 1):>7s}"
        )
    return "\n".join(lines)


def _figure(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
