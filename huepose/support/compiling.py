"""Says that kernels are being compiled: a first command on a computer would be silent for a minute or two."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, cast

from numba.core import event

from huepose.support.progress import Status


class CompilingNotice(event.Listener):  # type: ignore[misc]  # numba has no types
    """A line when the first kernel has to be compiled, then how many are. say: writes a line of a log."""

    def __init__(self, say: Callable[[str], None] | None = None) -> None:
        self._say, self._done = say, 0
        self._status: Status | None = None

    def on_start(self, event: Any) -> None:
        """A kernel, or one that it calls, begins to be compiled."""
        if self._status is None:
            self._started, self._status = time.monotonic(), Status(say=self._say)
            self._status.line("compiling kernels for this computer, once: some seconds to two minutes")

    def on_end(self, event: Any) -> None:
        """One is compiled."""
        self._done += 1
        if self._status is not None:
            self._status.show(f"{self._done} kernels compiled, {time.monotonic() - self._started:.0f} s")


def telling_of_compiling(say: Callable[[str], None] | None = None) -> AbstractContextManager[Any]:
    """As long as the context lasts; on standard error, or through `say`."""
    return cast(AbstractContextManager[Any], event.install_listener("numba:compile", CompilingNotice(say)))
