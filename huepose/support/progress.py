"""Progress of work that takes longer than two seconds: a bar on a terminal, some lines in a log."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Sized
from typing import TextIO, TypeVar

T = TypeVar("T")

_FIRST_LINE_S = 2.0
"""By then the remaining time can be estimated."""
_LINE_EVERY_S = 10.0
_DRAWN_EVERY_S = 0.1
_LOOK_EVERY_S = 0.5
_LEFT_AFTER, _LEFT_AFTER_S = 0.2, 10.0
"""The remaining time is shown after this share of the steps or these seconds: the first steps mislead."""


_bars = 0
"""Number of progress bars on the terminal now."""


def bar_is_drawn() -> bool:
    """Whether `progress` draws a bar on the terminal now."""
    return _bars > 0


class Status:
    """Shows how far work is. On a terminal it overwrites one line, at most ten times a second; in a log it
    writes a line after two seconds, then every ten.

    say: writes a line of a log; then `out` is not used."""

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
        """Erase the line on the terminal."""
        if self.live:
            self._out.write("\r\x1b[K")
            self._out.flush()

    def show(self, text: str) -> None:
        """Show `text` if a line is due."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + (_DRAWN_EVERY_S if self.live else _LINE_EVERY_S)
        if self.live:
            # The cursor goes back to the start of the line: other output begins there.
            self._out.write(f"\r{text}\x1b[K\r")
            self._out.flush()
        else:
            self.line(text)


def progress(
    items: Iterable[T], label: str, total: int | None = None, out: TextIO | None = None
) -> Generator[T, None, None]:
    """Yield `items`, drawing `label [#####     ] 5/10  3 s left`.

    Without a terminal it writes a line at the start, some that say how many are done, and one at the end. A
    thread writes them, so that a long step is not silent."""
    if total is None:
        total = len(items) if isinstance(items, Sized) else 0
    status, done, lock, ended = Status(out), 0, threading.Lock(), threading.Event()
    start = last = first = time.monotonic()

    def show() -> None:
        now = time.monotonic()
        # The first step may have waited for the compiler: the others say how long one takes.
        each_s = (last - first) / (done - 1) if done > 1 else 0.0
        left_s = each_s * (total - done) - (now - last)
        # The remaining time is unknown after few steps, and in a step that takes longer than those before.
        is_known = done > 1 and (done >= _LEFT_AFTER * total or now - start >= _LEFT_AFTER_S)
        left = f"{left_s:.0f} s left" if is_known and total and left_s >= 0.5 else ""
        if status.live and total:
            text = _bar(label, done, total, left or f"{now - start:.0f} s")
        else:
            rest = ", ".join(filter(None, [f"{now - start:.0f} s", left]))
            text = f"{label}: {done}{f' of {total}' if total else ''}, {rest}"
        with lock:
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
        with lock:
            ended.set()
        _bars -= status.live
        took = time.monotonic() - start
        if done == total or not total:  # if the work failed or was stopped, the caller reports it
            status.line(f"{label}: {done}{f' of {total}' if total else ''} in {took:.1f} s")
        else:
            status.clear()


def _bar(label: str, done: int, total: int, left: str) -> str:
    filled = round(30 * done / total)
    return f"{label} [{'#' * filled}{' ' * (30 - filled)}] {done}/{total}  {left} "
