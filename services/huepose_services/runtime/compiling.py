"""A worker that has to compile a kernel in the middle of its work tells its supervisor. Compiling takes
seconds, on a slow or busy computer many, and a worker that is killed meanwhile has to begin again.

All kernels are compiled before a worker is ready, so this should never happen; it is counted in health.
"""

from __future__ import annotations

import time
from typing import Any

from numba.core import event

from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.runtime.pulse import Pulse

_WORTH_A_LINE_S = 0.5


class LateCompiling(event.Listener):  # type: ignore[misc]  # numba has no types
    """Reports every kernel that is compiled from now on to pulse, health and log. Numba calls it under its
    lock; the calls for kernels that a kernel calls are nested in the call for that kernel."""

    def __init__(self, pulse: Pulse, health: Health, log: Log) -> None:
        self._pulse, self._health, self._log = pulse, health, log
        self._depth, self._started = 0, 0.0

    def on_start(self, event: Any) -> None:
        """The compilation of a kernel, or of one that it calls, begins."""
        if self._depth == 0:
            self._started = time.monotonic()
            self._pulse.compiling()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """The compilation has ended or failed."""
        self._depth -= 1
        if self._depth:
            return
        self._pulse.compiled()
        self._health.count("kernels_compiled_late")
        seconds = time.monotonic() - self._started
        if seconds > _WORTH_A_LINE_S:
            name = event.data["dispatcher"].py_func.__qualname__
            self._log.say(f"had to compile {name} first, {seconds:.1f} s")


def tell_of_late_compiling(pulse: Pulse, health: Health, log: Log) -> None:
    """Report the compilation of kernels in this process from now on."""
    event.register("numba:compile", LateCompiling(pulse, health, log))
