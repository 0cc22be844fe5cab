"""Follow the list of objects that the re-initialisation worker publishes.

A thread reads reference models from disk, so that the worker goes on meanwhile.
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
    """One change of the list: an object was added (`added` is what was loaded for it), or `removed`, or
    else it was reset and is searched for again."""

    entry: ObjectEntry
    added: T | None = None
    removed: bool = False


class Follower(Generic[T]):
    """`changes()`, called in every step, returns what has changed since the last call.

    load: gives what the worker keeps of an object, by its name; called in a thread, for one object at a
    time. known: the objects that the worker has already. remembers: whether to give the list back to the
    worker that publishes it, after that one has died (`recall`)."""

    def __init__(
        self, bus: Bus, load: Callable[[str], T], known: Iterable[str], remembers: bool = False
    ) -> None:
        self._bus, self._load = bus, load
        self._memory = Memory(bus) if remembers else None
        self._list = bus.inbox.ring(bus.keys.objects, wakes=False)
        self._known: dict[str, ObjectEntry | None] = dict.fromkeys(known)
        self._loading: set[str] = set()
        # An entry, what was loaded for it, and whether that is final (False: try again with the next list).
        self._loaded: queue.SimpleQueue[tuple[ObjectEntry, T | None, bool]] = queue.SimpleQueue()
        self._one_loads = threading.Lock()
        self._newest: dict[str, ObjectEntry] = {}
        self._first: set[tuple[str, int, int]] | None = None

    @property
    def reading(self) -> frozenset[str]:
        """The added objects whose models are being read."""
        return frozenset(self._loading)

    def changes(self) -> list[Change[T]]:
        """The changes, in the order in which to apply them; usually none."""
        message = self._bus.take(self._list, ObjectsMessage)
        out: list[Change[T]] = []
        if message is not None:
            if self._memory is not None:
                self._memory.keep(message)
            self._newest = {entry.object: entry for entry in self._without_old_boxes(message.objects)}
            out += self._gone() + self._resets()
            for name, entry in self._newest.items():
                if name not in self._known and name not in self._loading:
                    try:
                        threading.Thread(target=self._load_one, args=(entry,), daemon=True).start()
                        self._loading.add(name)
                    except RuntimeError as error:  # no more threads for now: also with the next list
                        self._fail(f"{name} is not loaded yet: {error}")
        while not self._loaded.empty():
            asked, item, settled = self._loaded.get()
            self._loading.discard(asked.object)
            if settled and self._goes_on(asked):
                entry = self._known[asked.object] = self._newest[asked.object]
                out += [] if item is None else [Change(entry, added=item)]
        return out

    def keep_up(self, kept: dict[str, T]) -> None:
        """Apply the changes to `kept`, what a worker keeps of each object, by name. Resets change
        nothing."""
        for change in self.changes():
            if change.removed:
                kept.pop(change.entry.object, None)
            elif change.added is not None:
                kept[change.entry.object] = change.added

    def _goes_on(self, entry: ObjectEntry) -> bool:
        """Whether the object is still in the list. One that was removed and added again is not the same,
        because its model may be another."""
        newest = self._newest.get(entry.object)
        return newest is not None and newest.added == entry.added

    def _without_old_boxes(self, entries: list[ObjectEntry]) -> list[ObjectEntry]:
        """The entries. A box that was given before the worker's first list is left out: the object may be
        elsewhere by now."""
        states = [(entry.object, entry.added, entry.resets) for entry in entries]
        self._first = set(states) if self._first is None else self._first
        return [
            msgspec.structs.replace(entry, box=None) if state in self._first else entry
            for entry, state in zip(entries, states, strict=True)
        ]

    def _gone(self) -> list[Change[T]]:
        gone = [
            name
            for name, before in self._known.items()
            if not (name in self._newest if before is None else self._goes_on(before))
        ]
        for name in gone:
            del self._known[name]
        return [Change(ObjectEntry(object=n, max_instances=1, searching=0), removed=True) for n in gone]

    def _resets(self) -> list[Change[T]]:
        out = []
        for name, before in self._known.items():
            entry = self._newest[name]
            # The first list shows the present number of resets; it orders none.
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
            # Memory or open files may run out for a moment: it is tried again with the next list.
            self._fail(f"{name} is not loaded yet: {type(error).__name__} {error}".rstrip())
        finally:
            self._loaded.put((entry, item, settled))

    def _fail(self, text: str) -> None:
        self._bus.health.failed(text)
        self._bus.log.seldom("load", text, level="error")


def reading_text(name: str) -> str:
    """The warning of a worker while it reads the model of an added object."""
    return f"the reference model of {name} is being read"


class Memory:
    """Answers queries on `objects` with the last published list, so that the list outlives its
    publisher."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._list: bytes | None = None
        bus.session.declare_queryable(bus.keys.objects, self._answer)

    def keep(self, message: ObjectsMessage) -> None:
        """Answer with this list from now on."""
        self._list = encode(message)

    def _answer(self, query: zenoh.Query) -> None:
        if self._list is not None:
            query.reply(self._bus.keys.objects, self._list)


def recall(bus: Bus) -> list[ObjectEntry]:
    """The list that another worker remembers; empty when the pipeline starts."""
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
    """Instances that ended because their object was reset or removed: messages about them that arrive later
    are ignored. below: [camera epoch, number] by object: the instances of that epoch with a lower
    number."""

    below: dict[str, tuple[int, int]] = {}

    @staticmethod
    def of(entries: Iterable[ObjectEntry]) -> Retired:
        """The retired instances that a list of objects names."""
        return Retired({entry.object: entry.retired for entry in entries if entry.retired is not None})

    def add(self, name: str, below: tuple[int, int] | None) -> None:
        """Note [camera epoch, number] for an object; None changes nothing."""
        if below is not None:
            self.below[name] = below

    def includes(self, name: str, epoch: int, instance: int) -> bool:
        """Whether that instance has ended."""
        below = self.below.get(name)
        return below is not None and below[0] == epoch and instance < below[1]


def is_over(pose: PoseMessage, objects: list[ObjectEntry] | None) -> bool:
    """Whether the object of a pose is no longer searched for, or was reset since. objects: the list of
    objects; None if none has arrived yet."""
    if objects is None:
        return False
    if all(entry.object != pose.object for entry in objects):
        return True
    return Retired.of(objects).includes(pose.object, pose.camera_epoch, pose.instance)
