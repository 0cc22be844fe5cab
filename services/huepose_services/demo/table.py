"""What the demo prints: a live table, updated four times a second, and the figures at the end."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, TextIO

from huepose.evaluation.summary import table
from huepose.support.words import counted, known
from huepose_services.demo.score import Latest

_PERIOD_S = 0.25
_MOSTLY = 90.0
"""Percent of the frames; for an object that is TRACKING in fewer, the reasons are printed."""

_COLOURS = {"TRACKING": "32", "SUSPECT": "33", "LOST": "31", "SEARCHING": "90"}


class Table:
    """One line for each object: state, error against ground truth, rate, age."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._colour = out.isatty()
        self._next = 0.0
        self._lines = 0

    def show(self, rows: Mapping[str, Latest]) -> None:
        """Print the table, if the last one is old enough."""
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
        error, age = known(row.error_m and 1000.0 * row.error_m), known(row.age_ms, ".0f")
        state = f"{row.state:10s}"
        if self._colour:
            state = f"\x1b[{_COLOURS[row.state]}m{state}\x1b[0m"
        return f"{name:24s} {state} {error:>9s} {row.rate_hz:>8.0f} {age:>7s}"


def report(result: Mapping[str, Any]) -> str:
    """The printed report: figures of each object and in total, then CPU, memory and times of each worker."""
    summary = result["summary"]
    head = ("object", "acquired s", "confirmed s", "ADD recall %", "median mm", "TRACKING %", "false")
    rows = [
        [
            name,
            known(figures["acquired_after_s"], ".2f"),
            known(figures["confirmed_after_s"], ".2f"),
            figures["recall_add"],
            known(figures.get("add_mm_p50"), ".2f"),
            figures["coverage_tracking"],
            figures["false_tracking_frames"],
        ]
        for name, figures in [*summary["per_object"].items(), ("all (times: the largest)", summary)]
    ]
    total = (
        f"capture to pose {known(summary['latency_ms_p50'])} ms "
        f"(p99 {known(summary['latency_ms_p99'])}) over {summary['frames']} frames, "
        f"{counted(summary['objects'], 'object')}; AUC ADD {known(summary['auc_add'])}, "
        f"ADD-S recall {known(summary['recall_adds'])} %"
    )
    workers = [
        [name, f"{of['cpu_percent']:.0f}", of["memory_mib"], of["rate_hz"], *(of["work_ms"] or (None, None))]
        for name, of in result["workers"].items()
    ]
    took = table(("worker", "CPU %", "MiB", "rate Hz", "work ms p50", "p99"), workers)
    why = [_why_not(name, figures) for name, figures in summary["per_object"].items()]
    parts = [table(head, rows), "\n".join(text for text in why if text), total, took]
    return "\n" + "\n\n".join(part for part in parts if part)


def _why_not(name: str, figures: Mapping[str, Any]) -> str:
    """Why an object was often not TRACKING; empty if it mostly was."""
    covered = figures["coverage_tracking"] or 0.0
    if covered >= _MOSTLY:
        return ""
    often = [
        f'{share:.0f} % of its poses say "{reason}"'
        for reason, share in figures["doubts"].items()
        if share >= 1.0
    ]
    return f"{name} was TRACKING in {covered:.0f} %; {', '.join(often[:3])}" if often else ""
