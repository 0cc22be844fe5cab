"""Plays a recording on the bus: frames, poses and other messages at their times, as if the pipeline ran.

All timestamps are shifted to now together, so that ages and intervals are those of the recording. For
`huepose poses`, `view` and all subscribers it looks like a pipeline. Each pass gets new camera epochs.
"""

from __future__ import annotations

import heapq
import secrets
from collections.abc import Iterable, Iterator
from typing import Any

import msgspec

from huepose_protos.keys import tail_of
from huepose_protos.messages import (
    FrameHeader,
    IntakeMessage,
    MemoryMessage,
    Message,
    ObjectEntry,
    ObjectsMessage,
)
from huepose_services.recording.parts import GIVEN
from huepose_services.recording.read import Event
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, this_clock

_REORDER_NS = SECOND // 2


def in_order(events: Iterable[Event]) -> Iterator[Event]:
    """Events in the order of their publish times; in the file they are only nearly in that order."""
    waiting: list[tuple[int, int, Event]] = []
    for number, event in enumerate(events):
        stamp_ns = event.message.publish_ns
        heapq.heappush(waiting, (stamp_ns, number, event))
        while waiting and waiting[0][0] < stamp_ns - _REORDER_NS:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


def _is_for_verify(event: Event) -> bool:
    return isinstance(event.message, IntakeMessage | MemoryMessage) or tail_of(event.key) == GIVEN


class Player:
    """One pass through a recording. Call `begin`, then `play` for each event when it is due (`due_ns`)."""

    def __init__(self, events: Iterable[Event], bus: Bus, speed: float) -> None:
        self._events = in_order(event for event in events if not _is_for_verify(event))
        self._bus, self._speed = bus, speed
        self._epochs: dict[int, int] = {}
        self._next = next(self._events, None)
        self._start_ns = self._recorded_ns = self.next_ns

    @property
    def finished(self) -> bool:
        """Whether all events were played."""
        return self._next is None

    @property
    def next_ns(self) -> int:
        """When the next event was published, in the recording; 0 at the end."""
        return 0 if self._next is None else self._next.message.publish_ns

    def begin(self, start_ns: int, recorded_ns: int) -> None:
        """Play at `start_ns` what was published at `recorded_ns`: the same times for all that play
        together."""
        self._start_ns, self._recorded_ns = start_ns, recorded_ns

    def due_ns(self) -> int:
        """When the next event is due."""
        return self._start_ns if self._next is None else self._moved(self._next.message.publish_ns)

    def _moved(self, stamp_ns: int) -> int:
        return self._start_ns + round((stamp_ns - self._recorded_ns) / self._speed)

    def play(self) -> None:
        """Publish the next event."""
        event = self._next
        if event is None:
            return
        self._next = next(self._events, None)
        key, message = self._bus.keys.of_tail(tail_of(event.key)), self._now(event.message)
        if isinstance(message, FrameHeader):
            self._bus.put_pixels(key, message, event.payload)
        else:
            self._bus.put(key, message)

    def _now(self, message: Message) -> Message:
        """The message with its timestamps shifted to this machine's clock, and the epoch of this pass."""
        changes: dict[str, Any] = {"publish_ns": self._moved(message.publish_ns)}
        for name in ("capture_ns", "mount_ns"):
            stamp_ns = getattr(message, name, None)
            if stamp_ns is not None:
                # The age is kept, at any speed.
                changes[name] = changes["publish_ns"] - (message.publish_ns - stamp_ns)
        epoch = getattr(message, "camera_epoch", None)
        if epoch is not None:
            changes["camera_epoch"] = self._epoch(epoch)
        if isinstance(message, ObjectsMessage):
            changes["objects"] = [self._entry(entry) for entry in message.objects]
        clock = this_clock()
        if hasattr(message, "clock"):
            changes["clock"] = clock
        if hasattr(message, "clock_id"):
            changes |= {"clock_id": clock.clock_id, "realtime_offset_ns": clock.realtime_offset_ns}
        return msgspec.structs.replace(message, **changes)

    def _epoch(self, recorded: int) -> int:
        """The epoch of this pass for a recorded one."""
        return self._epochs.setdefault(recorded, secrets.randbits(62))

    def _entry(self, entry: ObjectEntry) -> ObjectEntry:
        if entry.retired is None:
            return entry
        epoch, number = entry.retired
        return msgspec.structs.replace(entry, retired=(self._epoch(epoch), number))
