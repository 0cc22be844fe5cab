"""Messages under several keys, in the order in which they came, for a loop that may be slow.

Each is copied as it comes, so that no shared memory is held. Inputs of the tracker that did not come are
requested from it. If too much waits, frames that the tracker skipped are dropped first.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import zenoh

from huepose_protos import WireError, decode
from huepose_protos.keys import tail_of
from huepose_protos.messages import IntakeMessage, MemoryMessage
from huepose_services.runtime.bus import stamp_of

FRAMES_AT_ONCE, STEPS_AT_ONCE = 4, 64
_PATIENCE_S, _ASK_EVERY_S, _TIMES = 0.15, 0.5, 4
"""A message comes soon after it was sent; if it does not come after this many requests, it is lost."""
_KNOWN = 4096

FrameKey = tuple[int, int]


def frame_taken(step: IntakeMessage) -> FrameKey | None:
    """The frame that the tracker took in a step; None where it took none."""
    if step.camera_epoch is None or step.frame_id is None:
        return None
    return step.camera_epoch, step.frame_id


class Taken:
    """The inputs that the tracker reports, and which of them have not come: a recording must hold all of
    them. Called from several threads. `lost`: how many did not come on request; frames from before the
    first one that came do not count."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._here: dict[FrameKey, None] = {}
        self._first: FrameKey | None = None
        self._taken: dict[FrameKey, None] = {}
        self._newest: FrameKey | None = None
        self._step: IntakeMessage | None = None
        # What is missing, when to request it next, and how often that was done.
        self._missing: dict[FrameKey | int, tuple[float, int]] = {}
        self.lost = 0

    def frame(self, header: bytes) -> FrameKey | None:
        """Note a frame that came; returns its key, if it has a header."""
        frame = stamp_of(header)
        if frame is None:
            return None
        key = (frame.camera_epoch, frame.frame_id)
        with self._lock:
            self._first = self._first or key
            _remember(self._here, key)
            self._missing.pop(key, None)
        return key

    def dropped(self, key: FrameKey) -> None:
        """Note that a frame came and was not kept."""
        with self._lock:
            self._here.pop(key, None)
            if key in self._taken:
                self._miss(key)

    def message(self, key: str, data: bytes) -> None:
        """Note a message that came."""
        tail = tail_of(key)
        try:
            if tail == "tracker/memory":
                remembered = decode(data, MemoryMessage).frames
                with self._lock:
                    for frame in remembered:
                        self._take(frame)
            elif tail in ("tracker/intake", "tracker/again"):
                step = decode(data, IntakeMessage)
                with self._lock:
                    self._note(step)
        except WireError:
            return  # refused and counted where it is written

    def _note(self, message: IntakeMessage) -> None:
        last, frame = self._step, frame_taken(message)
        if last is None or message.publish_ns > last.publish_ns:
            self._step = message
            if last is not None:
                # A tracker that was restarted counts from the beginning.
                for seq in range(max(last.seq + 1, message.seq - STEPS_AT_ONCE), message.seq):
                    self._miss(seq)
            self._newest = frame or self._newest
        self._missing.pop(message.seq, None)
        if frame is not None:
            self._take(frame)

    def _take(self, key: FrameKey) -> None:
        _remember(self._taken, key)
        if key not in self._here:
            self._miss(key)

    def _miss(self, what: FrameKey | int) -> None:
        self._missing.setdefault(what, (time.monotonic() + _PATIENCE_S, 0))

    def _from_before(self, what: FrameKey | int) -> bool:
        """Whether it is a frame from before the recording, which the tracker still keeps."""
        first = self._first
        if first is None or not isinstance(what, tuple):
            return False
        return what[0] == first[0] and what[1] < first[1]  # epochs are random numbers

    def passed_over(self, key: FrameKey) -> bool:
        """Whether the tracker took a later frame, but not this one."""
        newest = self._newest
        return newest is not None and key[0] == newest[0] and key[1] < newest[1] and key not in self._taken

    def wanted(self, now: float) -> tuple[list[FrameKey], list[int]]:
        """What to request now (time.monotonic()): frames and steps."""
        frames: list[FrameKey] = []
        steps: list[int] = []
        with self._lock:
            for what, (due, times) in list(self._missing.items()):
                if now < due:
                    continue
                if times == _TIMES:
                    del self._missing[what]
                    self.lost += not self._from_before(what)
                elif isinstance(what, int) and len(steps) < STEPS_AT_ONCE:
                    steps.append(what)
                elif isinstance(what, tuple) and len(frames) < FRAMES_AT_ONCE:
                    frames.append(what)
                else:
                    continue
                if what in self._missing:
                    self._missing[what] = (now + _ASK_EVERY_S, times + 1)
        return frames, steps


def _remember(keys: dict[FrameKey, None], key: FrameKey) -> None:
    keys[key] = None
    if len(keys) > _KNOWN:
        del keys[next(iter(keys))]


_LOOK_EVERY_S = 0.1
Ask = Callable[[list[FrameKey], list[int]], Iterable[zenoh.Sample]]


@dataclass(frozen=True)
class Arrived:
    """The bytes of a message, or of a header with those of its pixels."""

    key: str
    header: bytes
    pixels: bytes
    frame: FrameKey | None = None


class Arrivals:
    """Subscriptions to these keys. A message with pixels is dropped, and counted in `missed`, if more than
    `most_bytes` would wait. ask: requests frames and steps; None: nothing is requested."""

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
        self._asking: threading.Thread | None = None
        if ask is not None:
            self._asking = threading.Thread(target=self._ask_again, args=(ask,), daemon=True)
            self._asking.start()

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
        for sample in channel:
            self._put(sample)

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
        """Whether there is room; if not, first drops waiting frames that the tracker skipped."""
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
        """The oldest message; None if there is none."""
        with self._ready:
            if not self._waiting:
                return None
            arrived = self._waiting.popleft()
            self._bytes -= len(arrived.pixels)
            return arrived

    def wait(self, timeout_s: float) -> None:
        """Wait until there is something to take, or the timeout."""
        with self._ready:
            if not self._waiting:
                self._ready.wait(timeout_s)

    @property
    def waiting(self) -> bool:
        """Whether there is something to take."""
        return bool(self._waiting)

    def unsubscribe(self) -> None:
        """End all subscriptions; what has come can still be taken. A thread that waits in zenoh when the
        interpreter ends would abort the process."""
        self._closed.set()
        if self._asking is not None:
            self._asking.join(3.0)  # an answer is waited for two seconds
        while self._subscriptions:
            subscriber, thread = self._subscriptions.pop()
            subscriber.undeclare()
            thread.join(1.0)

    def close(self) -> None:
        """End all subscriptions, and drop what waits."""
        self.unsubscribe()
        while (arrived := self.take()) is not None:
            if arrived.pixels:
                self._drop(arrived)
