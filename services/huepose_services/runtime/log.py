"""The log: one line per event on stderr, with time, level and worker. Repeats are held back.

As text (`14:03:21.512 warn  tracker   ...`), as JSON lines if HUEPOSE_LOG is `json`, or with systemd's level
prefixes and without the time if stderr goes to its journal.
"""

from __future__ import annotations

import json
import os
import re
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Literal, TextIO, get_args

_FIRST_S, _FACTOR, _LONGEST_S, _QUIET_S = 1.0, 4.0, 300.0, 60.0
_MOST_KINDS = 256
_LONG_AGO_S = 2.0
"""A line that was held back for longer says how long: it may no longer be true."""


@dataclass
class _Kind:
    wait_s: float
    until_s: float
    since_s: float
    last_s: float
    text: str
    held: int = 0


class Repeats:
    """Holds back repeated lines, more and more, so that they do not flood the log; each line that is written
    says how many were not. The time is an argument, in seconds.

    The second line of a kind is written after a second, the third after four more, then 16, 64, 256 and every
    five minutes. A kind that has not come for a minute, or for twice the wait, begins again.

    >>> repeats = Repeats()
    >>> repeats.offer("late", "late", 0.0), repeats.offer("late", "late", 0.5), repeats.due(1.0)
    ('late', None, [('late', 'late (1 more in 1 s)')])
    """

    def __init__(self) -> None:
        self._kinds: dict[str, _Kind] = {}

    def offer(self, kind: str, text: str, now_s: float) -> str | None:
        """The line to write now, with the number of lines that were held back; None: nothing."""
        known = self._kinds.get(kind)
        if known is None or now_s - known.last_s > max(_QUIET_S, 2.0 * known.wait_s):
            self._make_room()
            self._kinds[kind] = _Kind(_FIRST_S, now_s + _FIRST_S, now_s, now_s, text)
            return text
        known.last_s, known.text = now_s, text
        if now_s < known.until_s:
            known.held += 1
            return None
        return self._written(known, now_s)

    def due(self, now_s: float) -> list[tuple[str, str]]:
        """Kind and text of lines that were held back for long enough, without waiting for another one."""
        ripe = [(kind, known) for kind, known in self._kinds.items() if known.held and now_s >= known.until_s]
        return [(kind, self._written(known, now_s)) for kind, known in ripe]

    def _written(self, known: _Kind, now_s: float) -> str:
        ago_s = now_s - known.last_s
        ago = f", the last {ago_s:.0f} s ago" if ago_s >= _LONG_AGO_S else ""
        more = f" ({known.held} more in {now_s - known.since_s:.0f} s{ago})"
        text = known.text + (more if known.held else "")
        known.wait_s = min(_FACTOR * known.wait_s, _LONGEST_S)
        known.until_s, known.since_s, known.held = now_s + known.wait_s, now_s, 0
        return text

    def _make_room(self) -> None:
        """Forget the oldest kind if there are many."""
        if len(self._kinds) >= _MOST_KINDS:
            oldest = min(self._kinds, key=lambda kind: self._kinds[kind].last_s)
            del self._kinds[oldest]


Level = Literal["info", "warn", "error"]
_JOURNAL = {"info": "<6>", "warn": "<4>", "error": "<3>"}
_OWN_LINE = re.compile(r'\d\d:\d\d:\d\d\.\d{3} (info |warn |error) |\{"time": ')


def write(out: TextIO, text: str) -> None:
    """Write a line at once. If it cannot be written (a full disk, a closed pipe), it is lost and the work
    goes on."""
    with suppress(OSError):
        out.write(text)
        out.flush()


class Log:
    """The log of one worker, for all of its threads. The time is a label for people; nothing is computed from
    it."""

    def __init__(self, worker: str, out: TextIO | None = None) -> None:
        self._worker, self._out = worker, out
        self._repeats: dict[Level, Repeats] = {level: Repeats() for level in get_args(Level)}
        self._lock = threading.Lock()

    def say(self, text: str, level: Level = "info") -> None:
        """Write a text; each of its lines gets the same prefix."""
        lines = "".join(_formatted(line, level, self._worker) for line in text.splitlines())
        write(self._out or sys.stderr, lines)

    def warn(self, text: str) -> None:
        """Write a line about a problem with which the work goes on."""
        self.say(text, "warn")

    def error(self, text: str) -> None:
        """Write a line about work that failed."""
        self.say(text, "error")

    def seldom(self, kind: str, text: str, level: Level = "warn") -> None:
        """Write a line of a kind; repeats are held back and counted (`Repeats`)."""
        with self._lock:
            line = self._repeats[level].offer(kind, text, time.monotonic())
        if line is not None:
            self.say(line, level)

    def flush(self) -> None:
        """Write the lines that were held back for long enough; to be called often."""
        with self._lock:
            due = [(level, repeats.due(time.monotonic())) for level, repeats in self._repeats.items()]
        for level, lines in due:
            for _, text in lines:
                self.say(text, level)


class StateChanges:
    """Logs changes of state: a state must last for `moment_s`, and there is at most one line in `every_s` for
    each name, with the state at that time."""

    def __init__(self, log: Log, every_s: float = 1.0, moment_s: float = 0.2) -> None:
        self._log, self._every_s, self._moment_s = log, every_s, moment_s
        self._now: dict[str, tuple[str, str, float]] = {}
        self._logged: dict[str, tuple[str, float]] = {}

    def note(self, name: str, state: str, detail: str = "") -> None:
        """Set the present state."""
        before = self._now.get(name)
        since = time.monotonic() if before is None or before[0] != state else before[2]
        self._now[name] = (state, detail, since)

    def forget(self, under: str) -> None:
        """Forget all names below this one, `under/...`."""
        for known in (self._now, self._logged):
            for name in [name for name in known if name.startswith(f"{under}/")]:
                del known[name]

    def flush(self) -> None:
        """Write what is due; to be called often."""
        now = time.monotonic()
        for name, (state, detail, since) in self._now.items():
            logged, when = self._logged.get(name, ("", -1e9))
            if state == logged or now - since < self._moment_s or now - when < self._every_s:
                continue
            self._logged[name] = (state, now)
            before = f"{logged} > " if logged else ""
            self._log.say(f"{name} {before}{state}" + (f" ({detail})" if detail else ""))


def is_log_line(line: str) -> bool:
    """Whether a Log wrote a line; others come from libraries."""
    return _OWN_LINE.match(line) is not None


def relayed(line: str) -> str:
    """A line that the Log of a worker wrote into a pipe, in the form for this process's stderr."""
    match = _OWN_LINE.match(line)
    if match is None or match[1] is None or not _to_journal():
        return line
    rest = line[match.end() :]
    worker = rest.partition(" ")[0]
    return f"{_JOURNAL[match[1].strip()]}{worker}: {rest[max(9, len(worker)) + 1 :]}"


@cache
def _to_journal() -> bool:
    """Whether stderr is the stream that systemd connected to its journal (JOURNAL_STREAM)."""
    try:
        status = os.fstat(2)
    except OSError:
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"


def _formatted(text: str, level: Level, worker: str) -> str:
    if os.environ.get("HUEPOSE_LOG") == "json":
        stamp = time.time()
        return json.dumps({"time": round(stamp, 3), "level": level, "worker": worker, "text": text}) + "\n"
    if _to_journal():
        return f"{_JOURNAL[level]}{worker}: {text}\n"
    now = time.time()
    stamp_text = f"{time.strftime('%H:%M:%S', time.localtime(now))}.{int(now * 1000) % 1000:03d}"
    return f"{stamp_text} {level:5s} {worker:9s} {text}\n"
