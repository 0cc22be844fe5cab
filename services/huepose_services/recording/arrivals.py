"""What arrives under several keys, in the order in which it came, for a loop that may be slow.

A copy is made as it comes, so that no shared memory is held.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import zenoh


@dataclass(frozen=True)
class Arrived:
    """A message's bytes, or a header's with those of its pixels."""

    key: str
    header: bytes
    pixels: bytes


class Arrivals:
    """Subscriptions to these keys. What has pixels is `missed` where more than `most_bytes` wait."""

    def __init__(self, session: zenoh.Session, keys: Iterable[str], most_bytes: int) -> None:
        self._ready = threading.Condition()
        self._waiting: deque[Arrived] = deque()
        self._bytes, self._most_bytes = 0, most_bytes
        self.missed = 0
        self._subscriptions: list[tuple[Any, threading.Thread]] = []
        for key in keys:
            subscriber: Any = session.declare_subscriber(key, zenoh.handlers.FifoChannel(256))
            # The thread holds the channel only: a subscriber that is waited on cannot be undeclared.
            thread = threading.Thread(target=self._move, args=(subscriber.handler,), daemon=True)
            thread.start()
            self._subscriptions.append((subscriber, thread))

    def _move(self, channel: Any) -> None:
        try:
            while True:
                self._put(channel.recv())
        except zenoh.ZError:
            return  # the subscription has ended

    def _put(self, sample: zenoh.Sample) -> None:
        key, payload = str(sample.key_expr), sample.payload.to_bytes()
        if sample.attachment is None:
            arrived = Arrived(key, payload, b"")
        else:
            arrived = Arrived(key, sample.attachment.to_bytes(), payload)
        with self._ready:
            if arrived.pixels and self._bytes + len(arrived.pixels) > self._most_bytes:
                self.missed += 1
                return
            self._waiting.append(arrived)
            self._bytes += len(arrived.pixels)
            self._ready.notify()

    def take(self) -> Arrived | None:
        """The oldest; None when there is none."""
        with self._ready:
            if not self._waiting:
                return None
            arrived = self._waiting.popleft()
            self._bytes -= len(arrived.pixels)
            return arrived

    def wait(self, timeout_s: float) -> None:
        """Until something is there to take, at most so long."""
        with self._ready:
            if not self._waiting:
                self._ready.wait(timeout_s)

    def close(self) -> None:
        """Subscribe to nothing any more."""
        for subscriber, thread in self._subscriptions:
            subscriber.undeclare()
            thread.join(1.0)
