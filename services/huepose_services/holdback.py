"""How often a key may be sent: what comes too soon is held back, and only the newest of it goes out later."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from huepose_services.runtime.clock import SECOND

T = TypeVar("T")


@dataclass
class _Key(Generic[T]):
    next_ns: int
    held: T | None = None


class Holdback(Generic[T]):
    """A limit for each key on a clock that is passed in.

    >>> limit = Holdback(10.0)
    >>> limit.offer("pose", 1, 0), limit.offer("pose", 2, 1), limit.offer("pose", 3, 2)
    (1, None, None)
    >>> limit.due(SECOND // 10), limit.held
    ([('pose', 3)], 1)
    """

    def __init__(self, rate_hz: float) -> None:
        self.at_rate(rate_hz)
        self._keys: dict[str, _Key[T]] = {}
        self.held = 0
        """How many values were replaced by newer ones and never sent."""

    def at_rate(self, rate_hz: float) -> None:
        """From now on so often."""
        self._period_ns = int(SECOND / rate_hz)

    def offer(self, key: str, value: T, now_ns: int, urgent: bool = False) -> T | None:
        """The value if it may be sent now, else None: then it is held. An urgent one is never held."""
        place = self._keys.setdefault(key, _Key(now_ns))
        self.held += place.held is not None
        if urgent or now_ns >= place.next_ns:
            # Deadlines are absolute, so that a source a little faster than the limit is cut evenly.
            late_ns = now_ns - place.next_ns
            place.next_ns = (place.next_ns if 0 <= late_ns < self._period_ns else now_ns) + self._period_ns
            place.held = None
            return value
        place.held = value
        return None

    def due(self, now_ns: int) -> list[tuple[str, T]]:
        """What was held and may be sent now."""
        out = []
        for key, place in self._keys.items():
            if place.held is not None and now_ns >= place.next_ns:
                out.append((key, place.held))
                place.held = None
                place.next_ns += self._period_ns
        return out

    def next_ns(self) -> int | None:
        """When the first of what is held may be sent; None when nothing is."""
        return min((place.next_ns for place in self._keys.values() if place.held is not None), default=None)

    def forget(self, key: str) -> None:
        """A key that is no more."""
        self._keys.pop(key, None)
