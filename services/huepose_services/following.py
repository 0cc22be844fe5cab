"""Follow the list of objects that the re-initialisation worker publishes.

What has to be read from disk is read by a thread, so that the work goes on meanwhile.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

import msgspec
import zenoh

from huepose.support.errors import InputError
from huepose_protos import WireError, decode, encode
from huepose_protos.messages import ObjectEntry, ObjectsMessage, PoseMessage
from huepose_services.runtime.bus import Bus

T = TypeVar("T")
_TRIES, _TRY_S = 3, 0.2


@dataclass(frozen=True)
class Change(Generic[T]):
    """What a worker has to do: `added` with what was loaded for it, else `removed`, else search anew."""

    entry: ObjectEntry
    added: T | None = None
    removed: bool = False


class Follower(Generic[T]):
    """`changes()`, called in every step, says what has changed since it was last called.

    load: from an object's name to what the worker keeps of it, called in a thread, for one after the other;
    known: the objects that the worker has already; remembers: whether it tells the list to the worker that
    publishes it, should that one have died."""

    def __init__(
        self, bus: Bus, load: Callable[[str], T], known: Iterable[str], remembers: bool = False
    ) -> None:
        self._bus, self._load = bus, load
        self._memory = Memory(bus) if remembers else None
        self._list = bus.inbox.ring(bus.keys.objects, wakes=False)
        self._known: dict[str, ObjectEntry | None] = dict.fromkeys(known)
        self._loading: set[str] = set()
        # What was loaded for an entry, and whether to leave it at that.
        self._loaded: queue.SimpleQueue[tuple[ObjectEntry, T | None, bool]] = queue.SimpleQueue()
        self._one_loads = threading.Lock()
        self._newest: dict[str, ObjectEntry] = {}

    def changes(self) -> list[Change[T]]:
        """In the order in which they are to be made; mostly none."""
        message = self._bus.take(self._list, ObjectsMessage)
        out: list[Change[T]] = []
        if message is not None:
            if self._memory is not None:
                self._memory.keep(message)
            self._newest = {entry.object: entry for entry in message.objects}
            out += self._gone() + self._anew()
            for name, entry in self._newest.items():
                if name not in self._known and name not in self._loading:
                    threading.Thread(target=self._load_one, args=(entry,), daemon=True).start()
                    self._loading.add(name)
        while not self._loaded.empty():
            asked, item, settled = self._loaded.get()
            self._loading.discard(asked.object)
            if settled and self._goes_on(asked):
                entry = self._known[asked.object] = self._newest[asked.object]
                out += [] if item is None else [Change(entry, added=item)]
        return out

    def keep_up(self, kept: dict[str, T]) -> None:
        """Take the changes over into what a worker keeps of each object, by name."""
        for change in self.changes():
            if change.removed:
                kept.pop(change.entry.object, None)
            elif change.added is not None:
                kept[change.entry.object] = change.added

    def _goes_on(self, entry: ObjectEntry) -> bool:
        """Whether it is looked for, and was not removed and added again, maybe with another model, since."""
        newest = self._newest.get(entry.object)
        return newest is not None and newest.added == entry.added

    def _gone(self) -> list[Change[T]]:
        gone = [
            name
            for name, before in self._known.items()
            if not (name in self._newest if before is None else self._goes_on(before))
        ]
        for name in gone:
            del self._known[name]
        return [Change(ObjectEntry(object=n, max_instances=1, searching=0), removed=True) for n in gone]

    def _anew(self) -> list[Change[T]]:
        out = []
        for name, before in self._known.items():
            entry = self._newest[name]
            # A list that is seen for the first time says how it is, not that something was asked for.
            if before is not None and entry.resets != before.resets:
                out.append(Change[T](entry))
            self._known[name] = entry
        return out

    def _load_one(self, entry: ObjectEntry) -> None:
        name, item, settled = entry.object, None, False
        try:
            with self._one_loads:
                item, settled = self._load(name), True
        except InputError as error:
            settled = True
            self._fail(str(error))
        except Exception as error:
            # Memory or files may be short for a moment: it is tried again with the next list.
            self._fail(f"{name} is not loaded yet: {type(error).__name__} {error}".rstrip())
        finally:
            self._loaded.put((entry, item, settled))

    def _fail(self, text: str) -> None:
        self._bus.health.failed(text)
        self._bus.log.seldom("load", text, level="error")


class Memory:
    """Answers queries on `objects` with the list as it was last published: it outlives its maker."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._list: bytes | None = None
        bus.session.declare_queryable(bus.keys.objects, self._answer)

    def keep(self, message: ObjectsMessage) -> None:
        """Answer with this from now on."""
        self._list = encode(message)

    def _answer(self, query: zenoh.Query) -> None:
        if self._list is not None:
            query.reply(self._bus.keys.objects, self._list)


def recall(bus: Bus) -> list[ObjectEntry]:
    """The list as another worker remembers it; empty when the pipeline starts."""
    for _ in range(_TRIES):
        for reply in bus.session.get(bus.keys.objects, timeout=_TRY_S):
            if reply.ok is not None:
                try:
                    return decode(reply.ok.payload.to_bytes(), ObjectsMessage).objects
                except WireError as error:
                    bus.refuse(bus.keys.objects, error)
        time.sleep(_TRY_S)
    return []


class Retired(msgspec.Struct, array_like=True):
    """Instances that are over because their object was to be searched for anew: what is still on its way
    about them does not count. [camera epoch, number] by object: those of that epoch below that number."""

    below: dict[str, tuple[int, int]] = {}

    @staticmethod
    def of(entries: Iterable[ObjectEntry]) -> Retired:
        """As a list of objects says."""
        return Retired({entry.object: entry.retired for entry in entries if entry.retired is not None})

    def add(self, name: str, below: tuple[int, int] | None) -> None:
        """Note it for an object."""
        if below is not None:
            self.below[name] = below

    def includes(self, name: str, epoch: int, instance: int) -> bool:
        """Whether that instance is over."""
        below = self.below.get(name)
        return below is not None and below[0] == epoch and instance < below[1]


def is_over(pose: PoseMessage, objects: list[ObjectEntry] | None) -> bool:
    """Whether a pose is of an object that is looked for no longer, or that was to be searched for anew since.
    objects: the list of objects; None where it was not heard yet."""
    if objects is None:
        return False
    if all(entry.object != pose.object for entry in objects):
        return True
    return Retired.of(objects).includes(pose.object, pose.camera_epoch, pose.instance)
