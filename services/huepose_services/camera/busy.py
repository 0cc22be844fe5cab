"""Whether this computer is too busy for the camera: frames that come late once mean nothing, again and again
they do."""

from __future__ import annotations

from collections import deque

from huepose_services.runtime.clock import SECOND

_WINDOW_NS = 60 * SECOND
_OFTEN = 3


class Busy:
    """Counts how often the camera was late in the last minute."""

    def __init__(self) -> None:
        self._late: deque[tuple[int, int]] = deque()

    def late(self, by_ns: int, now_ns: int) -> str:
        """The camera is late; the line for the log."""
        self._late.append((now_ns, by_ns))
        return f"frames come {by_ns * 1e-6:.0f} ms late: this computer is busy"

    def warning(self, now_ns: int) -> str | None:
        """What is to be said as long as it is so; None when all is well."""
        while self._late and now_ns - self._late[0][0] > _WINDOW_NS:
            self._late.popleft()
        if len(self._late) < _OFTEN:
            return None
        worst_ms = max(by_ns for _, by_ns in self._late) * 1e-6
        return (
            f"this computer is busy: the camera was late {len(self._late)} times in the last minute, by up "
            f"to {worst_ms:.0f} ms; end other programs, or set camera.rate lower"
        )
