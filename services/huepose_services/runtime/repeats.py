"""What is said again and again is said rarer and rarer, each time with how often it was: a flooded log hides
what matters.

The second line of a kind comes after a second, the third after four more, then 16, 64, 256 and every five
minutes. What has not come for a minute, or for twice the wait, begins anew.
"""

from __future__ import annotations

from dataclasses import dataclass

_FACTOR, _LONGEST_S, _QUIET_S = 4.0, 300.0, 60.0
_MOST_KINDS = 256


@dataclass
class _Kind:
    wait_s: float
    until_s: float
    since_s: float
    last_s: float
    text: str
    held: int = 0


class Repeats:
    """On a clock that is passed in, in seconds.

    >>> repeats = Repeats()
    >>> repeats.offer("late", "late", 0.0), repeats.offer("late", "late", 0.5), repeats.due(1.0)
    ('late', None, [('late', 'late (1 more in 1 s)')])
    """

    def __init__(self) -> None:
        self._kinds: dict[str, _Kind] = {}

    def offer(self, kind: str, text: str, now_s: float, first_wait_s: float = 1.0) -> str | None:
        """What is to be written now, with the number of those that were not; None: nothing."""
        known = self._kinds.get(kind)
        if known is None or now_s - known.last_s > max(_QUIET_S, 2.0 * known.wait_s):
            self._make_room()
            self._kinds[kind] = _Kind(first_wait_s, now_s + first_wait_s, now_s, now_s, text)
            return text
        known.last_s, known.text = now_s, text
        if now_s < known.until_s:
            known.held += 1
            return None
        return self._written(known, now_s)

    def due(self, now_s: float) -> list[tuple[str, str]]:
        """Kind and text of what was held back for long enough, although none of it came since."""
        ripe = [(kind, known) for kind, known in self._kinds.items() if known.held and now_s >= known.until_s]
        return [(kind, self._written(known, now_s)) for kind, known in ripe]

    def _written(self, known: _Kind, now_s: float) -> str:
        more = f" ({known.held} more in {now_s - known.since_s:.0f} s)"
        text = known.text + (more if known.held else "")
        known.wait_s = min(_FACTOR * known.wait_s, max(_LONGEST_S, known.wait_s))
        known.until_s, known.since_s, known.held = now_s + known.wait_s, now_s, 0
        return text

    def _make_room(self) -> None:
        """Lines that are each another one are not remembered for ever."""
        if len(self._kinds) >= _MOST_KINDS:
            oldest = min(self._kinds, key=lambda kind: self._kinds[kind].last_s)
            del self._kinds[oldest]
