"""A progress bar on stderr for anything longer than two seconds; silent when stderr is not a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Sized
from typing import TextIO, TypeVar

T = TypeVar("T")


def progress(
    items: Iterable[T], label: str, total: int | None = None, out: TextIO | None = None
) -> Iterator[T]:
    """Yield `items`, drawing `label [#####     ] 5/10  3 s left` at most ten times a second.

    Not on a terminal, one line is written at the start and one at the end, so that logs stay short.
    """
    out = out or sys.stderr
    if total is None:
        total = len(items) if isinstance(items, Sized) else 0
    live = out.isatty()
    start = last = time.monotonic()
    if not live:
        print(f"{label}: {total or 'some'} steps", file=out, flush=True)
    elif total:
        out.write(_bar(label, 0, total, 0.0))
        out.flush()
    done = 0
    try:
        for item in items:
            yield item
            done += 1
            now = time.monotonic()
            if live and (now - last > 0.1 or done == total):
                last = now
                out.write("\r" + _bar(label, done, total, now - start))
                out.flush()
    finally:
        took = time.monotonic() - start
        if live:
            out.write("\r\x1b[K")
        print(f"{label}: {done}{f' of {total}' if total else ''} in {took:.1f} s", file=out, flush=True)


def _bar(label: str, done: int, total: int, elapsed: float) -> str:
    if not total:
        return f"{label} {done}  {elapsed:.0f} s"
    filled = round(30 * done / total)
    left = f"{elapsed / done * (total - done):.0f} s left" if done else ""
    return f"{label} [{'#' * filled}{' ' * (30 - filled)}] {done}/{total}  {left} \x1b[K"
