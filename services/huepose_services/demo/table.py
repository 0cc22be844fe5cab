"""The live table of the demo, drawn over itself four times a second."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TextIO

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
