"""How long perception takes, and what follows from that: how long to wait for it, and for a second sighting.

The times that are configured suit a computer that keeps up. On one that does not, a request that is asked
anew before it is answered is one more piece of work for those who are late already.
"""

from __future__ import annotations

from collections import deque

LONGEST_S = 10.0
"""Nothing is waited for longer than this."""

PATIENCE = 1.5
"""An answer may take so much longer than the last ones."""


class Pace:
    """Learns from requests and answers, by their numbers."""

    def __init__(self) -> None:
        self._asked: deque[tuple[int, int]] = deque(maxlen=64)
        self._took_s = self._age_s = 0.0

    def asked(self, number: int, now_ns: int) -> None:
        """A request goes out."""
        self._asked.append((number, now_ns))

    def answered(self, number: int, now_ns: int, stamp_ns: int) -> None:
        """An answer came, on a frame of that stamp. Slower at once, faster by and by."""
        self._age_s = max(0.0, (now_ns - stamp_ns) * 1e-9)
        took_s = next(((now_ns - ns) * 1e-9 for asked, ns in self._asked if asked == number), 0.0)
        self._took_s = max(took_s, 0.5 * (self._took_s + took_s))

    def expired(self, waited_s: float) -> None:
        """None came in that time. If the last ones took less, somebody has died, for whom the next request
        must not wait as long."""
        if waited_s >= self.deadline_s(0.0):
            self._took_s = 0.0

    @property
    def age_s(self) -> float:
        """How old the picture was when the last answer about it came."""
        return self._age_s

    def deadline_s(self, configured_s: float) -> float:
        """For how long the next request is waited for."""
        if self._took_s <= configured_s:
            return configured_s
        return max(configured_s, min(PATIENCE * self._took_s, LONGEST_S))

    def between_s(self, period_s: float) -> float:
        """How far answers lie apart."""
        return max(period_s, min(self._took_s, LONGEST_S))
