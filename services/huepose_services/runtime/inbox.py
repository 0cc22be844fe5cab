"""What arrives, for a loop with one thread: rings of one for frames, queues for what must not be lost.

A thread for each subscription moves samples from zenoh's channel to a place that the loop looks at, and
wakes the loop. A newer frame replaces the one that lies there: the age of what the loop takes is bounded by
its own work, never by a queue.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

import zenoh

_QUEUE_CAPACITY = 4096
Accepts = Callable[[zenoh.Sample], bool]


class Ring:
    """The newest sample of a subscription; it replaced at least `skipped` others. What `accepts` refuses
    replaces none; `failed`: how many there was no memory to look at."""

    def __init__(
        self, ready: threading.Condition, wakes: bool = True, accepts: Accepts | None = None
    ) -> None:
        self._ready = ready
        self._wakes = wakes
        self._accepts = accepts
        self._sample: zenoh.Sample | None = None
        self.skipped = self.failed = 0

    def _put(self, sample: zenoh.Sample) -> None:
        if self._accepts is not None and not self._accepts(sample):
            return
        with self._ready:
            self.skipped += self._sample is not None
            self._sample = sample
            if self._wakes:
                self._ready.notify()

    def take(self) -> zenoh.Sample | None:
        """The newest sample, once; None when there is no new one. Copy it out and drop it."""
        with self._ready:
            sample, self._sample = self._sample, None
            return sample

    def __bool__(self) -> bool:
        """Whether the loop should look at it now."""
        return self._wakes and self._sample is not None


class Queue:
    """All samples of a subscription in order; `lost` counts what a stuck loop made it drop, `failed`
    what there was no memory to take."""

    def __init__(self, ready: threading.Condition, wakes: bool = True) -> None:
        self._ready = ready
        self._wakes = wakes
        self._samples: deque[zenoh.Sample] = deque()
        self.lost = self.failed = 0

    def _put(self, sample: zenoh.Sample) -> None:
        with self._ready:
            if len(self._samples) >= _QUEUE_CAPACITY:
                self._samples.popleft()
                self.lost += 1
            self._samples.append(sample)
            if self._wakes:
                self._ready.notify()

    def take(self) -> zenoh.Sample | None:
        """The oldest sample; None when there is none."""
        with self._ready:
            return self._samples.popleft() if self._samples else None

    def __bool__(self) -> bool:
        """Whether the loop should look at it now."""
        return self._wakes and bool(self._samples)


class Inbox:
    """All subscriptions of a loop."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._ready = threading.Condition()
        self._subscriptions: dict[Ring | Queue, tuple[Any, threading.Thread]] = {}

    def ring(
        self,
        key: str,
        wakes: bool = True,
        accepts: Accepts | None = None,
        session: zenoh.Session | None = None,
    ) -> Ring:
        """Subscribe for the newest only; `wakes` False: the loop need not look at it when it arrives;
        `accepts`: called in the subscription's thread with each, None for all; session: another one."""
        ring = Ring(self._ready, wakes, accepts)
        # Room for one that is refused beside one that counts.
        channel: Any = zenoh.handlers.RingChannel(1 if accepts is None else 2)
        self._start((session or self._session).declare_subscriber(key, channel), ring)
        return ring

    def queue(self, key: str, wakes: bool = True, session: zenoh.Session | None = None) -> Queue:
        """Subscribe for everything; session: another one."""
        queue = Queue(self._ready, wakes)
        channel: Any = zenoh.handlers.FifoChannel(256)
        self._start((session or self._session).declare_subscriber(key, channel), queue)
        return queue

    def liveliness(self, key: str) -> Queue:
        """Subscribe to liveliness tokens, those that are there already first. They wake nobody."""
        queue = Queue(self._ready, wakes=False)
        tokens = self._session.liveliness()
        self._start(tokens.declare_subscriber(key, zenoh.handlers.FifoChannel(256), history=True), queue)
        return queue

    def _start(self, subscriber: Any, place: Ring | Queue) -> None:
        # The thread holds the channel only: a subscriber that is waited on cannot be undeclared.
        thread = threading.Thread(target=self._move, args=(subscriber.handler, place), daemon=True)
        thread.start()
        self._subscriptions[place] = (subscriber, thread)

    @classmethod
    def _move(cls, channel: Any, place: Ring | Queue) -> None:
        # A thread that ends for want of memory would be a worker that hears nothing any more.
        while not cls._moved_all(channel, place):
            place.failed += 1

    @staticmethod
    def _moved_all(channel: Any, place: Ring | Queue) -> bool:
        """Until the subscription has ended; False: there was no memory for one."""
        try:
            while True:
                place._put(channel.recv())
        except zenoh.ZError:
            return True
        except Exception:
            return False

    @property
    def drops(self) -> int:
        """Samples that were replaced or dropped before the loop took them, where it means to take each."""
        places = list(self._subscriptions)
        rings = sum(place.skipped for place in places if isinstance(place, Ring) and place._wakes)
        failed = sum(place.failed for place in places)
        return rings + failed + sum(place.lost for place in places if isinstance(place, Queue))

    def wait(self, timeout_s: float) -> None:
        """Until something is there to take, at most so long."""
        with self._ready:
            if timeout_s > 0 and not any(self._subscriptions):
                self._ready.wait(timeout_s)

    def forget(self, place: Ring | Queue) -> None:
        """End a subscription."""
        subscriber, thread = self._subscriptions.pop(place)
        subscriber.undeclare()
        thread.join(1.0)

    def close(self) -> None:
        """End all subscriptions."""
        for place in list(self._subscriptions):
            self.forget(place)
