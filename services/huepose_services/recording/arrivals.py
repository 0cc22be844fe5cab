"""What arrives under several keys, in the order in which it came, for a loop that may be slow.

A copy is made as it comes, so that no shared memory is held. What the tracker took and did not come is asked
for; where too much waits, frames that the tracker passed over go first.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import zenoh

from huepose_services.recording.taken import FrameKey, Taken

_LOOK_EVERY_S = 0.1
Ask = Callable[[list[FrameKey], list[int]], Iterable[zenoh.Sample]]


@dataclass(frozen=True)
class Arrived:
    """A message's bytes, or a header's with those of its pixels."""

    key: str
    header: bytes
    pixels: bytes
    frame: FrameKey | None = None


class Arrivals:
    """Subscriptions to these keys. What has pixels is `missed` where more than `most_bytes` wait; ask: for
    frames and steps again, None: nobody can be asked."""

    def __init__(
        self, session: zenoh.Session, keys: Iterable[str], most_bytes: int, ask: Ask | None = None
    ) -> None:
        self.taken = Taken()
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
        self._closed = threading.Event()
        if ask is not None:
            threading.Thread(target=self._ask_again, args=(ask,), daemon=True).start()

    def _ask_again(self, ask: Ask) -> None:
        while not self._closed.wait(_LOOK_EVERY_S):
            frames, steps = self.taken.wanted(time.monotonic())
            if frames or steps:
                try:
                    for sample in ask(frames, steps):
                        self._put(sample)
                except zenoh.ZError:
                    return  # the session has ended

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
            self.taken.message(key, payload)
        else:
            header = sample.attachment.to_bytes()
            arrived = Arrived(key, header, payload, self.taken.frame(header))
        with self._ready:
            if arrived.pixels and not self._has_room(len(arrived.pixels)):
                self._drop(arrived)
                return
            self._waiting.append(arrived)
            self._bytes += len(arrived.pixels)
            self._ready.notify()

    def _has_room(self, size: int) -> bool:
        """Whether there is, if need be for frames that nobody computes anything from."""
        if self._bytes + size > self._most_bytes:
            for one in [o for o in self._waiting if o.frame is not None and self.taken.passed_over(o.frame)]:
                self._waiting.remove(one)
                self._bytes -= len(one.pixels)
                self._drop(one)
                if self._bytes + size <= self._most_bytes:
                    break
        return self._bytes + size <= self._most_bytes

    def _drop(self, arrived: Arrived) -> None:
        self.missed += 1
        if arrived.frame is not None:
            self.taken.dropped(arrived.frame)

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
        self._closed.set()
        for subscriber, thread in self._subscriptions:
            subscriber.undeclare()
            thread.join(1.0)
