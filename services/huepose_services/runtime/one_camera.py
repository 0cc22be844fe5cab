"""Accept one camera epoch at a time: while its frames arrive, those of other epochs are ignored.

A new epoch voids all that is tracked, so a frame of another one must not be enough for it. The epoch that is
heard changes when it falls silent, as a camera that was opened anew does; or when another one is heard twice
as often, as it must be that came second.
"""

from __future__ import annotations

from collections import deque

from huepose_services.runtime.clock import SECOND

SHORTEST_NS, LONGEST_NS = SECOND // 2, 5 * SECOND
"""A camera is silent after three times the time between its last two frames, within these bounds."""
_GAPS = 3
_WINDOW_NS = 3 * SECOND
_MOST_KEPT = 1024


class OneCamera:
    """Which camera epoch counts. `refused`: how many frames of others came.

    again_counts: whether a frame that comes again shows that its camera is still there. A pose that comes
    again does not: it is said again when no new frame comes."""

    def __init__(self, again_counts: bool = True) -> None:
        self.refused = 0
        self._again_counts = again_counts
        self._epoch: int | None = None
        self._heard_ns, self._gap_ns = 0, 0
        # Of its newest frame, and when that first came.
        self._stamp_ns, self._came_ns = -1, 0
        self._arrived: deque[tuple[int, int]] = deque(maxlen=_MOST_KEPT)

    def accepts(self, epoch: int, stamp_ns: int, now_ns: int) -> bool:
        """Whether what is about a frame of that epoch, with that stamp, counts that arrives now."""
        if not self._again_counts and (epoch, stamp_ns) == (self._epoch, self._stamp_ns):
            return True
        while self._arrived and now_ns - self._arrived[0][0] > _WINDOW_NS:
            self._arrived.popleft()
        self._arrived.append((now_ns, epoch))
        if epoch == self._epoch:
            # Several poses of one frame come at nearly the same time. A frame may be shown again and again;
            # but what is said again of a frame of a camera that is gone makes nobody wait longer.
            again_ns = min(now_ns - self._heard_ns, SHORTEST_NS)
            again = stamp_ns == self._stamp_ns
            gap_ns = max(self._gap_ns, again_ns) if again else now_ns - self._came_ns
        elif self.agrees(epoch, now_ns) or self._is_heard_more(epoch):
            self._epoch, self._stamp_ns, gap_ns = epoch, -1, 0
        else:
            self.refused += 1
            return False
        if stamp_ns != self._stamp_ns:
            self._stamp_ns, self._came_ns = stamp_ns, now_ns
        self._heard_ns, self._gap_ns = now_ns, gap_ns
        return True

    def agrees(self, epoch: int, now_ns: int) -> bool:
        """Whether what is about a frame of that epoch counts now; nothing changes by it."""
        patience_ns = min(max(_GAPS * self._gap_ns, SHORTEST_NS), LONGEST_NS)
        return self._epoch in (None, epoch) or now_ns - self._heard_ns > patience_ns

    def _is_heard_more(self, epoch: int) -> bool:
        other = sum(e == epoch for _, e in self._arrived)
        mine = sum(e == self._epoch for _, e in self._arrived)
        # Only when there was time to hear both.
        return self._arrived[-1][0] - self._arrived[0][0] > _WINDOW_NS // 2 and other > 2 * mine
