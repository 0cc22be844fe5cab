"""Measure how long perception takes, and derive deadlines from it.

The configured times suit a computer that keeps up. On a slower one, repeating a request before it is answered
would add work to processes that are already late.
"""

from __future__ import annotations

from collections import deque

LONGEST_S = 10.0
"""Longest deadline, seconds."""

PATIENCE = 1.5
"""Deadline over the duration of the last answers."""


class Pace:
    """Learns from requests and answers, by their numbers."""

    def __init__(self) -> None:
        self._asked: deque[tuple[int, int]] = deque(maxlen=64)
        self._took_s = self._age_s = 0.0

    def asked(self, number: int, now_ns: int) -> None:
        """A request goes out."""
        self._asked.append((number, now_ns))

    def answered(self, number: int, now_ns: int, stamp_ns: int) -> None:
        """Note an answer on a frame of that stamp. The estimate rises at once and falls slowly."""
        self._age_s = max(0.0, (now_ns - stamp_ns) * 1e-9)
        took_s = next(((now_ns - ns) * 1e-9 for asked, ns in self._asked if asked == number), 0.0)
        self._took_s = max(took_s, 0.5 * (self._took_s + took_s))

    def expired(self, waited_s: float) -> None:
        """Note that no answer came in that time. If earlier answers took less, a process has died, and the
        next deadline stays short."""
        if waited_s >= self.deadline_s(0.0):
            self._took_s = 0.0

    @property
    def age_s(self) -> float:
        """Age of the frame at the last answer about it, seconds."""
        return self._age_s

    def deadline_s(self, configured_s: float) -> float:
        """Deadline of the next request, seconds."""
        if self._took_s <= configured_s:
            return configured_s
        return max(configured_s, min(PATIENCE * self._took_s, LONGEST_S))

    def between_s(self, period_s: float) -> float:
        """Expected time between answers, seconds."""
        return max(period_s, min(self._took_s, LONGEST_S))
