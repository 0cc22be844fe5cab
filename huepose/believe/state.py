"""What may be believed of an object's pose, in one word: of an estimate and of a track alike."""

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
        """Its word, in every version of Python."""
        return str.__str__(self)

    def __format__(self, spec: str) -> str:
        """Its word."""
        return str.__format__(self, spec)
