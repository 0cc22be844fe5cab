"""What is said while something takes longer than two seconds: a bar on a terminal, in a log some lines."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Sized
from typing import TextIO, TypeVar

T = TypeVar("T")

_FIRST_LINE_S = 2.0
"""By then something is known of how long it will take."""
_LINE_EVERY_S = 10.0


class Pace:
    """When a log may have its next line on something that goes on."""

    def __init__(self) -> None:
        self._next = time.monotonic() + _FIRST_LINE_S

    def due(self) -> bool:
        """Whether it is time: after two seconds, then every ten."""
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + _LINE_EVERY_S
        return True


def progress(
    items: Iterable[T], label: str, total: int | None = None, out: TextIO | None = None
) -> Iterator[T]:
    """Yield `items`, drawing `label [#####     ] 5/10  3 s left` at most ten times a second.

    Not on a terminal, a line is written at the start, one after two seconds, which says how many are left,
    one every ten seconds from then on, and one at the end.
    """
    out = out or sys.stderr
    if total is None:
        total = len(items) if isinstance(items, Sized) else 0
    live = out.isatty()
    start = last = first = time.monotonic()
    pace, done = Pace(), 0

    def left() -> str:
        """The first step may have waited for the compiler: the others say how long one takes."""
        return f"{(now - first) / (done - 1) * (total - done):.0f} s left" if done > 1 and total else ""

    if not live:
        print(f"{label}: {f'0 of {total}' if total else 'begun'}", file=out, flush=True)
    elif total:
        out.write(_bar(label, 0, total, 0.0, ""))
        out.flush()
    try:
        for item in items:
            yield item
            done += 1
            now = time.monotonic()
            first = now if done == 1 else first
            if live and (now - last > 0.1 or done == total):
                last = now
                out.write("\r" + _bar(label, done, total, now - start, left()))
                out.flush()
            elif not live and done != total and pace.due():
                rest = ", ".join(filter(None, [f"{now - start:.0f} s", left()]))
                print(f"{label}: {done}{f' of {total}' if total else ''}, {rest}", file=out, flush=True)
    finally:
        took = time.monotonic() - start
        if live:
            out.write("\r\x1b[K")
        print(f"{label}: {done}{f' of {total}' if total else ''} in {took:.1f} s", file=out, flush=True)


def _bar(label: str, done: int, total: int, elapsed: float, left: str) -> str:
    if not total:
        return f"{label} {done}  {elapsed:.0f} s"
    filled = round(30 * done / total)
    return f"{label} [{'#' * filled}{' ' * (30 - filled)}] {done}/{total}  {left} \x1b[K"
