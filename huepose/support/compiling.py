"""Shows that kernels are being compiled: otherwise a first command on a computer is silent for a minute or
two.

Compiled kernels are counted; their total is known once all modules are imported. A command needs most of
them and says "of up to"; setup needs all.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from numba.core import event

from huepose.support.jit import KERNELS, NOT_KEPT, name_of
from huepose.support.progress import Status, bar_is_drawn

_FEWEST = 3
"""Kernels that are compiled before the remaining time is estimated."""


class CompilingNotice(event.Listener):  # type: ignore[misc]  # numba has no types
    """Writes a line when the first kernel is compiled, then the number of compiled kernels, and a last
    line. say: writes a line of a log; every: whether all kernels will be compiled."""

    def __init__(self, say: Callable[[str], None] | None = None, every: bool = False) -> None:
        self._say, self._every = say, every
        self._done: set[str] = set()
        self._status: Status | None = None

    def on_start(self, event: Any) -> None:
        """The compilation of a function starts."""
        if self._status is None:
            self._started, self._status = time.monotonic(), Status(say=self._say)
            once = "" if NOT_KEPT else ", once"
            self._status.line(f"compiling kernels for this computer{once}: some seconds to two minutes")

    def on_end(self, event: Any) -> None:
        """The compilation of a function has ended. Numba's own functions, which kernels call, are not
        counted."""
        name = name_of(event.data["dispatcher"].py_func)
        if self._status is None or name not in KERNELS:
            return
        self._done.add(name)
        self._ended = time.monotonic()
        if not (self._status.live and bar_is_drawn()):
            self._status.show(self._how_far())

    def _how_far(self) -> str:
        done, all_of_them = len(self._done), len(KERNELS)
        took_s = time.monotonic() - self._started
        text = f"{done} of {'' if self._every else 'up to '}{all_of_them} kernels compiled, {took_s:.0f} s"
        if done < _FEWEST:
            return text
        left_s = took_s / done * (all_of_them - done)
        return f"{text}, {'' if self._every else 'up to '}{left_s:.0f} s left"

    def finish(self) -> None:
        """Write the last line."""
        if self._status is not None and self._done:
            took_s = self._ended - self._started
            self._status.line(f"{len(self._done)} kernels compiled in {took_s:.0f} s")


@contextmanager
def telling_of_compiling(
    say: Callable[[str], None] | None = None, every: bool = False
) -> Generator[None, None, None]:
    """A context in which a `CompilingNotice` writes to standard error, or through `say`."""
    notice = CompilingNotice(say, every)
    with event.install_listener("numba:compile", notice):
        yield
    notice.finish()
