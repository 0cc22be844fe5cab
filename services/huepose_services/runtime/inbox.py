"""Incoming messages for a single-threaded loop: ring buffers of one for frames, queues for messages that must
not be lost.

For each subscription a thread moves samples from zenoh's channel to a `Place` that the loop reads, and wakes
the loop. A newer frame replaces an older one there: how old a frame is when the loop takes it depends on the
loop's own work only, never on a queue.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import zenoh

_QUEUE_CAPACITY = 4096
Accepts = Callable[[zenoh.Sample], bool]


class Place:
    """The newest samples of a subscription, in order: one frame, or so many other messages that only a stuck
    loop loses some. A sample that `accepts` refuses replaces none. `skipped`: how many were replaced by newer
    ones before they were taken; `failed`: how many were lost by an exception, as for want of memory."""

    def __init__(
        self, ready: threading.Condition, capacity: int, wakes: bool = True, accepts: Accepts | None = None
    ) -> None:
        self._ready = ready
        self._wakes = wakes
        self._accepts = accepts
        self._samples: deque[zenoh.Sample] = deque(maxlen=capacity)
        self.skipped = self.failed = 0
        self.all_count = wakes or capacity > 1
        """Whether the loop is to take every sample."""

    def _put(self, sample: zenoh.Sample) -> None:
        if self._accepts is not None and not self._accepts(sample):
            return
        with self._ready:
            self.skipped += len(self._samples) == self._samples.maxlen
            self._samples.append(sample)
            if self._wakes:
                self._ready.notify()

    def take(self) -> zenoh.Sample | None:
        """The oldest sample, once; None when there is none. Copy it out and drop it."""
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
        self._subscriptions: dict[Place, tuple[Any, threading.Thread]] = {}
        self._served: list[tuple[Any, threading.Thread]] = []

    def ring(
        self,
        key: str,
        wakes: bool = True,
        accepts: Accepts | None = None,
        session: zenoh.Session | None = None,
    ) -> Place:
        """Subscribe to the newest sample only. `wakes` False: its arrival does not wake the loop; `accepts`:
        called in the subscription's thread with each sample, None accepts all; session: another one than the
        inbox's."""
        ring = Place(self._ready, 1, wakes, accepts)
        # Room for one that is refused and one that is accepted.
        channel: Any = zenoh.handlers.RingChannel(1 if accepts is None else 2)
        self._start((session or self._session).declare_subscriber(key, channel), ring)
        return ring

    def queue(
        self, key: str, wakes: bool = True, session: zenoh.Session | None = None, own: bool = True
    ) -> Place:
        """Subscribe to all samples; session: another one than the inbox's; own: also to what that session
        publishes itself."""
        queue = Place(self._ready, _QUEUE_CAPACITY, wakes)
        channel: Any = zenoh.handlers.FifoChannel(256)
        origin = zenoh.Locality.ANY if own else zenoh.Locality.REMOTE
        subscriber = (session or self._session).declare_subscriber(key, channel, allowed_origin=origin)
        self._start(subscriber, queue)
        return queue

    def history(self, key: str, session: zenoh.Session) -> Place:
        """Subscribe to what advanced publishers keep and will publish, now or when they appear later."""
        from zenoh import ext

        queue = Place(self._ready, _QUEUE_CAPACITY)
        kept = ext.HistoryConfig(detect_late_publishers=True)
        channel: Any = zenoh.handlers.FifoChannel(256)
        self._start(ext.declare_advanced_subscriber(session, key, channel, history=kept), queue)
        return queue

    def liveliness(self, key: str) -> Place:
        """Subscribe to liveliness tokens, first those that are there already. They do not wake the loop."""
        queue = Place(self._ready, _QUEUE_CAPACITY, wakes=False)
        tokens = self._session.liveliness()
        self._start(tokens.declare_subscriber(key, zenoh.handlers.FifoChannel(256), history=True), queue)
        return queue

    def _start(self, subscriber: Any, place: Place) -> None:
        # The thread holds the channel only: a subscriber that is waited on cannot be undeclared.
        thread = threading.Thread(target=self._move, args=(subscriber.handler, place), daemon=True)
        thread.start()
        self._subscriptions[place] = (subscriber, thread)

    def serve(self, key: str, answer: Callable[[zenoh.Query], None]) -> None:
        """Answer queries in a thread of their own, because an answer may wait for its reader."""
        # The thread holds the channel only: a queryable that is waited on cannot be undeclared.
        queries: Any = self._session.declare_queryable(key, zenoh.handlers.FifoChannel(16))
        thread = threading.Thread(target=self._answer, args=(queries.handler, answer), daemon=True)
        thread.start()
        self._served.append((queries, thread))

    @staticmethod
    def _answer(channel: Any, answer: Callable[[zenoh.Query], None]) -> None:
        with suppress(zenoh.ZError):  # the session ends while it answers
            for query in channel:
                with query:
                    answer(query)

    @staticmethod
    def _move(channel: Any, place: Place) -> None:
        while True:
            try:
                place._put(channel.recv())
            except zenoh.ZError:  # noqa: PERF203  # cheap beside the cost of a message
                return  # the subscription has ended
            except Exception:
                # If this thread ended, as for want of memory, the worker would receive nothing any more.
                place.failed += 1

    @property
    def drops(self) -> int:
        """Samples that were lost, or replaced before the loop took them, if it is to take every one."""
        places = list(self._subscriptions)
        return sum(place.failed + (place.skipped if place.all_count else 0) for place in places)

    def wait(self, timeout_s: float) -> None:
        """Wait until there is something to take, or the timeout."""
        with self._ready:
            if timeout_s > 0 and not any(self._subscriptions):
                self._ready.wait(timeout_s)

    def forget(self, place: Place) -> None:
        """End a subscription."""
        _end(*self._subscriptions.pop(place))

    def close(self) -> None:
        """End all subscriptions, and answer no more queries."""
        for place in list(self._subscriptions):
            self.forget(place)
        while self._served:
            _end(*self._served.pop())


def _end(declared: Any, thread: threading.Thread) -> None:
    """End the thread as well: one that waits in zenoh when the interpreter ends would abort the process."""
    declared.undeclare()
    thread.join(1.0)
