"""Tell a user who starts a single worker that it waits for the camera's frames."""

from __future__ import annotations

import os

from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.runtime.tied import SUPERVISOR

PATIENCE_NS = 5 * SECOND
"""A running camera gives its first frame sooner, even one that is plugged in only now."""

MISSING = (
    "no frame has come yet: `huepose run camera` starts the camera's worker, `huepose up` starts all; "
    "`huepose status` shows which are running"
)


class FirstFrame:
    """Warns for one worker. With a supervisor it does nothing: the camera worker, which starts then, too,
    reports its faults itself."""

    def __init__(self, health: Health, log: Log) -> None:
        self._health, self._log = health, log
        # By this computer's clock, also when a recording is replayed.
        self._awaited_since_ns = None if SUPERVISOR in os.environ else now_ns()

    def look(self, came: bool) -> None:
        """Warn once while no frame has ever come. came: whether one has just come."""
        since_ns = self._awaited_since_ns
        if came:
            self._awaited_since_ns = None
            self._health.warn_while("frames", None)
        elif since_ns is not None and now_ns() - since_ns > PATIENCE_NS:
            self._awaited_since_ns = None
            self._health.warn_while("frames", MISSING)
            self._log.warn(MISSING)
