"""The log: one line per event on stderr, with time, level and worker. Repeats are held back.

As text (`14:03:21.512 warn  tracker   ...`), as JSON lines where HUEPOSE_LOG is `json`, and with systemd's
level prefixes where stderr goes to its journal, which knows the time itself.
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from typing import Literal, TextIO

Level = Literal["info", "warn", "error"]
_JOURNAL = {"info": "<6>", "warn": "<4>", "error": "<3>"}
_OWN_LINE = re.compile(r'\d\d:\d\d:\d\d\.\d{3} (info |warn |error) |\{"time": ')


class Log:
    """The log of one worker. The time is a label for people; nothing is computed from it."""

    def __init__(self, worker: str, out: TextIO | None = None) -> None:
        self._worker, self._out = worker, out
        self._last: dict[str, float] = {}
        self._held: dict[str, int] = {}

    def say(self, text: str, level: Level = "info") -> None:
        """Write a line; each line of a longer text gets the same beginning."""
        out = self._out or sys.stderr
        out.write("".join(_formatted(line, level, self._worker) for line in text.splitlines()))
        out.flush()

    def warn(self, text: str) -> None:
        """Write a line about something that is not as it should be, while the work goes on."""
        self.say(text, "warn")

    def error(self, text: str) -> None:
        """Write a line about work that failed."""
        self.say(text, "error")

    def seldom(self, kind: str, text: str, every_s: float = 1.0, level: Level = "warn") -> None:
        """Write a line of a kind at most once in a while, saying how many were held back."""
        now = time.monotonic()
        if now - self._last.get(kind, -1e9) < every_s:
            self._held[kind] = self._held.get(kind, 0) + 1
            return
        held = self._held.pop(kind, 0)
        self._last[kind] = now
        self.say(text + (f" ({held} more like it before)" if held else ""), level)


def is_log_line(line: str) -> bool:
    """Whether a line was written by a Log; others come from libraries."""
    return _OWN_LINE.match(line) is not None


def _formatted(text: str, level: Level, worker: str) -> str:
    if os.environ.get("HUEPOSE_LOG") == "json":
        stamp = time.time()
        return json.dumps({"time": round(stamp, 3), "level": level, "worker": worker, "text": text}) + "\n"
    if "JOURNAL_STREAM" in os.environ:
        return f"{_JOURNAL[level]}{worker}: {text}\n"
    now = time.time()
    stamp_text = f"{time.strftime('%H:%M:%S', time.localtime(now))}.{int(now * 1000) % 1000:03d}"
    return f"{stamp_text} {level:5s} {worker:9s} {text}\n"
