"""Map a camera's own clock to CLOCK_MONOTONIC, with its drift removed.

An image arrives some time after its capture. This delay has a fixed part, which the host cannot measure,
and a varying part, which is never negative. So the pairs (device time, arrival) lie above a line, and the
fastest ones lie on it. The line is fitted to the fastest pair of each second of the last minute (the lower
side of their convex hull); its slope is the drift, a few parts in a hundred thousand on real cameras.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise

from huepose_services.runtime.clock import SECOND

_BUCKET_NS = SECOND
_BUCKETS = 60
_EARLY_NS, _LATE_NS = SECOND // 2, 2 * SECOND
_MAX_DRIFT = 1e-3
_DRIFT_NEEDS_NS = 5 * SECOND


class DeviceClock:
    """Call it for every image; it returns the capture time on CLOCK_MONOTONIC.

    The returned timestamps increase. They are never later than the arrival, provided that the arrivals
    increase. If the device clock jumps or restarts, a new line begins; `restarts` counts this.

    >>> clock = DeviceClock()
    >>> clock.capture_ns(5_000, arrived_ns=105_000)
    105000
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._fastest: deque[tuple[int, int]] = deque(maxlen=_BUCKETS)
        self._bucket: int | None = None
        self._origin = (0, 0)
        self.drift = 0.0
        """Seconds by which this machine's clock gains on the device's clock in one second."""
        self._last: tuple[int, int, int] | None = None

    def capture_ns(self, device_ns: int, arrived_ns: int) -> int:
        """The capture time of the image with that device time, estimated from the fastest images."""
        if self._last is not None and self._jumped(device_ns, arrived_ns):
            self.restarts += 1
            self._fastest.clear()
            self._bucket, self.drift = None, 0.0
        if not self._fastest:
            self._origin = (device_ns, arrived_ns)
        # Nanoseconds since boot soon need more than a float's 53 bits: all is relative to the origin.
        device, arrived = device_ns - self._origin[0], arrived_ns - self._origin[1]
        self._learn(device, arrived)
        at, behind = self._line()
        stamp = round(device + behind + self.drift * (device - at)) + self._origin[1]
        stamp = min(stamp, arrived_ns)
        if self._last is not None:
            # If the line moves down, the last timestamp was too late. The following ones are closer
            # together until they reach the line; they must not be equal, because a tracker needs time
            # between two frames.
            before_ns, last = self._last[0], self._last[2]
            stamp = max(stamp, min(last + (device_ns - before_ns) // 2, arrived_ns), last + 1)
        self._last = (device_ns, arrived_ns, stamp)
        return stamp

    def _jumped(self, device_ns: int, arrived_ns: int) -> bool:
        """Whether the device clock jumped: by the line, the image arrives before its capture or seconds
        later."""
        assert self._last is not None
        if device_ns < self._last[0]:
            return True
        at, behind = self._fastest[-1]
        device, arrived = device_ns - self._origin[0], arrived_ns - self._origin[1]
        late = arrived - device - behind - self.drift * (device - at)
        return not -_EARLY_NS < late < _LATE_NS

    def _learn(self, device: int, arrived: int) -> None:
        """Keep the fastest pair (device, arrived - device) of each second."""
        bucket = device // _BUCKET_NS
        if bucket != self._bucket:
            self._bucket = bucket
            self._fastest.append((device, arrived - device))
        elif arrived - device < self._fastest[-1][1] + self.drift * (device - self._fastest[-1][0]):
            self._fastest[-1] = (device, arrived - device)

    def _line(self) -> tuple[float, float]:
        """A point (device, offset) on the line below all pairs; updates the drift."""
        pairs = list(self._fastest)
        span = pairs[-1][0] - pairs[0][0]
        if span < _DRIFT_NEEDS_NS:
            return min(pairs, key=lambda p: p[1])
        middle = pairs[0][0] + span / 2
        hull: list[tuple[int, int]] = []
        for pair in pairs:
            while len(hull) > 1 and _slope(hull[-2], pair) <= _slope(hull[-2], hull[-1]):
                hull.pop()
            hull.append(pair)
        # The edge of the hull over the middle is the line below all pairs with the least sum of distances.
        for a, b in pairwise(hull):
            if a[0] <= middle <= b[0]:
                self.drift = min(max(_slope(a, b), -_MAX_DRIFT), _MAX_DRIFT)
                return middle, a[1] + self.drift * (middle - a[0])
        return hull[-1]


def _slope(a: tuple[int, int], b: tuple[int, int]) -> float:
    return (b[1] - a[1]) / max(b[0] - a[0], 1)
