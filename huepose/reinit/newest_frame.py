"""The camera's newest frame, as far as poses and answers tell. It may begin an epoch, or show that the
camera's clock was set back."""

from __future__ import annotations

from enum import Enum, auto

MOST_ENDED = 16
"""This many ended epochs are remembered: late messages are about the last one or two."""


class Began(Enum):
    """What began with a frame."""

    NOTHING = auto()
    EPOCH = auto()
    CLOCK = auto()
    """The clock was set back: the frame has a later number than the newest, and an earlier timestamp."""


class NewestFrame:
    """The newest frame of the present epoch, None before the first; timestamps in ns."""

    def __init__(self) -> None:
        self.epoch: int | None = None
        self._number = self._stamp_ns = 0
        self._ended: dict[int, int] = {}
        """The newest timestamps of epochs that have ended."""
        self._first, self._before_ns = 0, 0
        """Of the clock: the number of its first frame, and the latest timestamp before it was set back."""

    def note(self, epoch: int, number: int, stamp_ns: int) -> Began:
        """Note a frame that a message is about. A frame of an ended epoch counts only if its timestamp is
        later than all of that epoch, and than the newest."""
        began = Began.NOTHING
        if epoch != self.epoch:
            if epoch in self._ended and stamp_ns <= max(self._ended[epoch], self._stamp_ns):
                return began
            self._end()
            began = Began.EPOCH
        elif not self.is_of(epoch, number, stamp_ns):
            return began
        elif stamp_ns < self._stamp_ns:
            if number <= self._number:
                return began
            self._first, self._before_ns = number, max(self._before_ns, self._stamp_ns)
            began = Began.CLOCK
        self.epoch, self._number, self._stamp_ns = epoch, number, stamp_ns
        return began

    def is_of(self, epoch: int, number: int, stamp_ns: int) -> bool:
        """Whether a frame is of the present epoch, and not from before its clock was set back."""
        return epoch == self.epoch and (number >= self._first or stamp_ns > self._before_ns)

    def _end(self) -> None:
        if self.epoch is not None:
            self._ended.pop(self.epoch, None)
            self._ended[self.epoch] = max(self._stamp_ns, self._before_ns)
            if len(self._ended) > MOST_ENDED:
                del self._ended[next(iter(self._ended))]
        self._first = self._before_ns = 0
