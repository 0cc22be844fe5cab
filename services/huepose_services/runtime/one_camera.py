"""Accept one camera epoch at a time: while its frames arrive, those of other epochs are ignored.

A new epoch ends all tracks, so a single frame of another epoch must not be enough for it. The accepted epoch
changes when its frames stop, as when a camera is opened again, or when more than twice as many frames come of
another epoch.
"""

from __future__ import annotations

from collections import deque

from huepose_services.runtime.clock import SECOND

SHORTEST_NS, LONGEST_NS = SECOND // 2, 5 * SECOND
"""A camera counts as silent after three times the interval between its last two frames, within these
bounds."""
_GAPS = 3
_WINDOW_NS = 3 * SECOND
_MOST_KEPT = 1024


class OneCamera:
    """Which camera epoch is accepted. `refused`: how many frames of others came.

    again_counts: whether a repeated frame shows that its camera is still there. A repeated pose does not:
    poses are repeated when no new frame comes."""

    def __init__(self, again_counts: bool = True) -> None:
        self.refused = 0
        self._again_counts = again_counts
        self._epoch: int | None = None
        self._heard_ns, self._gap_ns = 0, 0
        # The timestamp of its newest frame, and when that frame first came.
        self._stamp_ns, self._came_ns = -1, 0
        self._arrived: deque[tuple[int, int]] = deque(maxlen=_MOST_KEPT)

    def accepts(self, epoch: int, stamp_ns: int, now_ns: int) -> bool:
        """Whether a message that arrives now, about a frame of that epoch and timestamp, is accepted."""
        if not self._again_counts and (epoch, stamp_ns) == (self._epoch, self._stamp_ns):
            return True
        while self._arrived and now_ns - self._arrived[0][0] > _WINDOW_NS:
            self._arrived.popleft()
        self._arrived.append((now_ns, epoch))
        if epoch == self._epoch:
            # Several poses of one frame come at nearly the same time. A frame may also be repeated; but
            # repeats of the last frame of a camera that is gone must not make the wait longer.
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
        """Whether a message about a frame of that epoch would be accepted now; changes nothing."""
        patience_ns = min(max(_GAPS * self._gap_ns, SHORTEST_NS), LONGEST_NS)
        return self._epoch in (None, epoch) or now_ns - self._heard_ns > patience_ns

    def _is_heard_more(self, epoch: int) -> bool:
        other = sum(e == epoch for _, e in self._arrived)
        mine = sum(e == self._epoch for _, e in self._arrived)
        # Only if there was time to receive both.
        return self._arrived[-1][0] - self._arrived[0][0] > _WINDOW_NS // 2 and other > 2 * mine
