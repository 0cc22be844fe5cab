"""Says that kernels are being compiled: a first command on a computer would be silent for a minute or two."""

from __future__ import annotations

import sys
import time
from contextlib import AbstractContextManager
from typing import Any, TextIO, cast

from numba.core import event


class CompilingNotice(event.Listener):  # type: ignore[misc]  # numba has no types
    """A line when the first kernel has to be compiled, and on a terminal a count of those that are done."""

    def __init__(self, out: TextIO) -> None:
        self._out, self._depth, self._done, self._started = out, 0, 0, 0.0

    def on_start(self, event: Any) -> None:
        """A kernel, or one that it calls, begins to be compiled."""
        if not self._started:
            self._started = time.monotonic()
            print("compiling kernels for this computer, once: one to two minutes", file=self._out, flush=True)
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """One is compiled."""
        self._depth -= 1
        if self._depth == 0 and self._out.isatty():
            self._done += 1
            seconds = time.monotonic() - self._started
            self._out.write(f"\r\x1b[K{self._done} kernels compiled, {seconds:.0f} s\r")
            self._out.flush()


def telling_of_compiling() -> AbstractContextManager[Any]:
    """On standard error, as long as the context lasts."""
    return cast(
        AbstractContextManager[Any], event.install_listener("numba:compile", CompilingNotice(sys.stderr))
    )
