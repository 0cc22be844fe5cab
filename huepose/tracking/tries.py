"""How many costly proposals there is time for: searches, parts of a wide search, or near-symmetric
rotations."""

from __future__ import annotations

import numpy as np

LONGEST_EARNED_S = 1.0 / 3.0
"""Longest time between frames that earns tries: else slow steps would cause slower ones."""


class Tries:
    """The costly proposals of one step; per_s: how many in a second of the frames' time, None for no limit.

    >>> tries = Tries(30.0)
    >>> tries.earn(0.1)
    >>> tries.spend(2.0)
    >>> tries.whole
    1.0
    """

    def __init__(self, per_s: float | None) -> None:
        self._per_s, self._left = per_s, 1.0

    def earn(self, seconds: float) -> None:
        """Add the proposals for the time since the last frame; unused ones do not accumulate."""
        earned = np.inf if self._per_s is None else self._per_s * min(seconds, LONGEST_EARNED_S)
        self._left = min(self._left + earned, max(1.0, earned))

    def spend(self, tried: float) -> None:
        """Count used proposals."""
        self._left -= tried

    @property
    def whole(self) -> float:
        """How many are left in this step, a whole number."""
        return float(np.floor(self._left + 0.5))
