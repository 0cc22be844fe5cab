"""The state of an object's pose, for estimates and tracks alike."""

from __future__ import annotations

from enum import Enum


class State(str, Enum):
    """Only TRACKING may be acted on. A member is the text of its name, also in comparisons, print and JSON.

    >>> State.TRACKING == "TRACKING", f"{State.LOST}"
    (True, 'LOST')
    """

    SEARCHING = "SEARCHING"
    """Not seen yet."""
    TRACKING = "TRACKING"
    """The pose may be acted on."""
    SUSPECT = "SUSPECT"
    """A pose is published; do not act on it."""
    LOST = "LOST"
    """No pose."""

    def __str__(self) -> str:
        """The name, in every version of Python."""
        return str.__str__(self)

    def __format__(self, spec: str) -> str:
        """The name."""
        return str.__format__(self, spec)
