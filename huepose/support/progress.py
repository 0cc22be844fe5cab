"""What is said while something takes longer than two seconds: a bar on a terminal, in a log some lines."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Sized
from typing import TextIO, TypeVar

T = TypeVar("T")

_FIRST_LINE_S = 2.0
"""By then something is known of how long it will take."""
_LINE_EVERY_S = 10.0
_DRAWN_EVERY_S = 0.1
_LOOK_EVERY_S = 0.5
_TOLD_AFTER, _TOLD_AFTER_S = 0.2, 10.0
"""Share of the steps, or seconds, after which it is told how long the rest takes: the first mislead."""


_bars = 0
"""Of those that are drawn on a terminal now."""


def bar_is_drawn() -> bool:
    """Whether `progress` has the terminal's line."""
    return _bars > 0


class Status:
    """How far something is. On a terminal in one line that is written over, at most ten times a second; in a
    log as a line after two seconds, then every ten.

    say: writes a line of a log, whatever `out` is."""

    def __init__(self, out: TextIO | None = None, say: Callable[[str], None] | None = None) -> None:
        self._out, self._say = out or sys.stderr, say
        self.live = say is None and self._out.isatty()
        now = time.monotonic()
        self._due = now if self.live else now + _FIRST_LINE_S

    def line(self, text: str) -> None:
        """A line that stays."""
        if self._say is not None:
            self._say(text)
            return
        self.clear()
        print(text, file=self._out, flush=True)

    def clear(self) -> None:
        """Nothing of it stays."""
        if self.live:
            self._out.write("\r\x1b[K")
            self._out.flush()

    def show(self, text: str) -> None:
        """Where it is time for it."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + (_DRAWN_EVERY_S if self.live else _LINE_EVERY_S)
        if self.live:
            # The cursor at its start: what others write begins there.
            self._out.write(f"\r{text}\x1b[K\r")
            self._out.flush()
        else:
            self.line(text)


def progress(
    items: Iterable[T], label: str, total: int | None = None, out: TextIO | None = None
) -> Generator[T, None, None]:
    """Yield `items`, drawing `label [#####     ] 5/10  3 s left`.

    Not on a terminal, a line is written at the start, then some that say how many are left, and one at the
    end. A step that takes long is not silent: what is said of it is said by a thread."""
    if total is None:
        total = len(items) if isinstance(items, Sized) else 0
    status, done, saying, ended = Status(out), 0, threading.Lock(), threading.Event()
    start = last = first = time.monotonic()

    def show() -> None:
        now = time.monotonic()
        # The first step may have waited for the compiler: the others say how long one takes.
        each_s = (last - first) / (done - 1) if done > 1 else 0.0
        left_s = each_s * (total - done) - (now - last)
        # Of a step that takes longer than those before it, nobody knows how long; nor of many, by a few.
        told = done > 1 and (done >= _TOLD_AFTER * total or now - start >= _TOLD_AFTER_S)
        left = f"{left_s:.0f} s left" if told and total and left_s >= 0.5 else ""
        if status.live and total:
            text = _bar(label, done, total, left or f"{now - start:.0f} s")
        else:
            rest = ", ".join(filter(None, [f"{now - start:.0f} s", left]))
            text = f"{label}: {done}{f' of {total}' if total else ''}, {rest}"
        with saying:
            if not ended.is_set():
                status.show(text)

    def tell() -> None:
        while not ended.wait(_LOOK_EVERY_S):
            show()

    if not status.live:
        status.line(f"{label}: {f'0 of {total}' if total else 'begun'}")
    elif total:
        show()
    threading.Thread(target=tell, daemon=True).start()
    global _bars
    _bars += status.live
    try:
        for item in items:
            yield item
            done, last = done + 1, time.monotonic()
            first = last if done == 1 else first
            if done != total:
                show()
    finally:
        with saying:
            ended.set()
        _bars -= status.live
        took = time.monotonic() - start
        if done == total or not total:  # of what failed or was stopped, whoever stopped it says all
            status.line(f"{label}: {done}{f' of {total}' if total else ''} in {took:.1f} s")
        else:
            status.clear()


def _bar(label: str, done: int, total: int, left: str) -> str:
    filled = round(30 * done / total)
    return f"{label} [{'#' * filled}{' ' * (30 - filled)}] {done}/{total}  {left} "
