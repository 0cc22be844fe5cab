"""Says to who starts a worker alone that it waits for a camera's frames."""

from __future__ import annotations

import os

from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.runtime.tied import SUPERVISOR

PATIENCE_NS = 5 * SECOND
"""A camera that is there shows its first frame sooner, also one that is plugged in."""

MISSING = (
    "no frame has come yet: `huepose run camera` starts the camera's worker, `huepose up` starts all; "
    "`huepose status` says which are there"
)


class FirstFrame:
    """Of one worker. With a supervisor a camera starts beside it, and says itself what is in its way."""

    def __init__(self, health: Health, log: Log) -> None:
        self._health, self._log = health, log
        # By this computer's clock, not by that of a recording, which is read where frames are.
        self._awaited_since_ns = None if SUPERVISOR in os.environ else now_ns()

    def look(self, came: bool) -> None:
        """Say once that no frame has ever come, until one does. came: one just did."""
        since_ns = self._awaited_since_ns
        if came:
            self._awaited_since_ns = None
            self._health.warn_while("frames", None)
        elif since_ns is not None and now_ns() - since_ns > PATIENCE_NS:
            self._awaited_since_ns = None
            self._health.warn_while("frames", MISSING)
            self._log.warn(MISSING)
