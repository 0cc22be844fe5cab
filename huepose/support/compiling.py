"""Says that kernels are being compiled: a first command on a computer would be silent for a minute or two."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, TextIO, cast

from numba.core import event

from huepose.support.progress import Pace


class CompilingNotice(event.Listener):  # type: ignore[misc]  # numba has no types
    """A line when the first kernel has to be compiled, then how many are: on a terminal always, in a log now
    and then. say: writes a line; live: the terminal, where there is one."""

    def __init__(self, say: Callable[[str], None], live: TextIO | None = None) -> None:
        self._say, self._live, self._done, self._started = say, live, 0, 0.0

    def on_start(self, event: Any) -> None:
        """A kernel, or one that it calls, begins to be compiled."""
        if not self._started:
            self._started, self._pace = time.monotonic(), Pace()
            self._say("compiling kernels for this computer, once: some seconds to two minutes")

    def on_end(self, event: Any) -> None:
        """One is compiled."""
        self._done += 1
        text = f"{self._done} kernels compiled, {time.monotonic() - self._started:.0f} s"
        if self._live is not None:
            self._live.write(f"\r\x1b[K{text}\r")
            self._live.flush()
        elif self._pace.due():
            self._say(text)


def telling_of_compiling(say: Callable[[str], None] | None = None) -> AbstractContextManager[Any]:
    """As long as the context lasts; on standard error, or through `say`."""
    live = sys.stderr if say is None and sys.stderr.isatty() else None
    notice = CompilingNotice(say or partial(print, file=sys.stderr, flush=True), live)
    return cast(AbstractContextManager[Any], event.install_listener("numba:compile", notice))
