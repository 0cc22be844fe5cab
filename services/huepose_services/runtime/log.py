"""One line of log per event, on stderr: wall-clock time, worker, text. Repeats are held back."""

from __future__ import annotations

import sys
import time


class Log:
    """The log of one worker. The time is a label for people; nothing is computed from it."""

    def __init__(self, worker: str) -> None:
        self._worker = worker
        self._last: dict[str, float] = {}
        self._held: dict[str, int] = {}

    def say(self, text: str) -> None:
        """Write a line."""
        stamp = time.strftime("%H:%M:%S")
        print(f"{stamp} {self._worker:9s} {text}", file=sys.stderr, flush=True)

    def seldom(self, kind: str, text: str, every_s: float = 1.0) -> None:
        """Write a line of a kind at most once in a while, saying how many were held back."""
        now = time.monotonic()
        if now - self._last.get(kind, -1e9) < every_s:
            self._held[kind] = self._held.get(kind, 0) + 1
            return
        held = self._held.pop(kind, 0)
        self._last[kind] = now
        self.say(text + (f" ({held} more like it before)" if held else ""))
