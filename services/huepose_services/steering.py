"""The list of objects of a running pipeline, and the service that changes it (a zenoh queryable).

A request is answered after it was checked and its reference model was loaded. The re-initialisation loop
applies the change at its next step; all other workers follow the published list.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import zenoh

from huepose.geometry.box import given_box
from huepose.reinit.types import ObjectSlot
from huepose.support.errors import InputError
from huepose.support.words import counted
from huepose_protos import WireError, decode, encode
from huepose_protos.messages import MOST_OBJECTS, ControlReply, ControlRequest, ObjectEntry
from huepose_services.runtime.bus import Bus, bytes_of
from huepose_services.runtime.clock import now_ns

_FULL = f"{MOST_OBJECTS} objects are searched for, which is the most: remove one first"
# Followers only check whether the number of resets has changed, so it may wrap around.
_RESETS = 2**31


@dataclass(frozen=True)
class Order:
    """An accepted change for the loop. entry: the new entry of the object, None if it was removed."""

    name: str
    entry: ObjectEntry | None
    slot: ObjectSlot | None = None
    """Given for an object that is new, or has another number of instances."""
    anew: bool = False
    """Whether its tracks are dropped and it is searched for again."""


class ObjectList:
    """The objects that are searched for. load: gives what the loop needs of an object, by its name and
    number of instances; raises InputError for an object without a reference model. picture_size: width and
    height of the camera's images, None before the first."""

    picture_size: tuple[int, int] | None = None

    def __init__(self, entries: list[ObjectEntry], load: Callable[[str, int], ObjectSlot]) -> None:
        self._entries = {entry.object: entry for entry in entries}
        self._added = max((entry.added for entry in entries), default=0)
        self._load = load
        self._lock = threading.Lock()
        self._orders: list[Order] = []

    def entries(self) -> list[ObjectEntry]:
        """The objects that are searched for now."""
        with self._lock:
            return list(self._entries.values())

    def settled(self) -> list[ObjectEntry] | None:
        """The same list if the loop has applied all accepted changes, else None. A list with a pending
        change must not be published: the entry of a reset also names the instances that end by it."""
        with self._lock:
            return None if self._orders else list(self._entries.values())

    def orders(self) -> list[Order]:
        """The changes that were accepted since the last call."""
        with self._lock:
            out, self._orders = self._orders, []
            return out

    def tell(self, name: str, searching: int, retired: tuple[int, int] | None, reason: str) -> None:
        """Update the entry of an object with what the loop knows, if the object is still in the list."""
        with self._lock:
            if name in self._entries:
                self._entries[name] = msgspec.structs.replace(
                    self._entries[name], searching=searching, retired=retired, reason=reason
                )

    def decide(self, request: ControlRequest) -> tuple[bool, str]:
        """Apply a request. Returns whether it was done, and a sentence that says what was done or why it
        was not."""
        name = request.object
        if name is None:
            return True, ""
        if request.box is not None:
            try:
                given_box(request.box, self.picture_size)
            except InputError as error:
                return False, str(error)
        if request.action == "add":
            with self._lock:
                known = self._entries.get(name)
            return self._add(request, name, known)
        with self._lock:
            known = self._entries.get(name)
            if known is None:
                return False, f"{name} is not searched for; what is: {', '.join(self._entries) or 'nothing'}"
            if request.action == "remove":
                self._take(Order(name, None))
                return True, f"{name} is no longer searched for"
            # The new entry forgets where the object was, and why it was not found.
            entry = msgspec.structs.replace(
                known,
                resets=(known.resets + 1) % _RESETS,
                box=request.box,
                searching=known.max_instances,
                reason="",
            )
            self._take(Order(name, entry, anew=True))
        return True, f"{name} is searched for again"

    def _add(self, request: ControlRequest, name: str, known: ObjectEntry | None) -> tuple[bool, str]:
        count = request.max_instances
        if known is not None and known.max_instances == count:
            fix = f"; to search for it again: huepose objects reset {name}"
            return False, f"{name} is searched for already (up to {counted(count, 'instance')}){fix}"
        if known is not None and request.box is not None:
            fix = f"huepose objects reset {name} --box X Y W H"
            return False, f"{name} is searched for already: add takes no box then; to search there: {fix}"
        if known is None and len(self._entries) >= MOST_OBJECTS:
            return False, _FULL
        try:
            slot = self._load(name, count)
        except InputError as error:
            return False, str(error)
        fresh = ObjectEntry(object=name, max_instances=count, searching=count)
        # Requests come from two threads, and loading takes a while.
        with self._lock:
            now = self._entries.get(name)
            if (now and now.max_instances) == (known and known.max_instances):
                if now is None and len(self._entries) >= MOST_OBJECTS:
                    return False, _FULL
                if now is None:
                    self._added += 1
                    now = msgspec.structs.replace(fresh, added=self._added)
                entry = msgspec.structs.replace(now, max_instances=count, box=request.box)
                self._take(Order(name, entry, slot))
                return True, f"{name} is searched for, up to {counted(count, 'instance')}"
        return self._add(request, name, now)

    def _take(self, order: Order) -> None:
        self._orders.append(order)
        if order.entry is None:
            self._entries.pop(order.name, None)
        else:
            self._entries[order.name] = order.entry


def answer_control(bus: Bus, objects: ObjectList) -> None:
    """Answer queries on the key `control` from now on, in a zenoh thread."""

    def answer(query: zenoh.Query) -> None:
        try:
            request = decode(bytes_of(query.payload), ControlRequest)
            done, text = objects.decide(request)
            if request.action != "list":
                bus.log.say(text if done else f"refused to {request.action}: {text}")
        except WireError as error:
            bus.refuse(bus.keys.control, error)
            done, text = False, f"not a request: {error}"
        reply = ControlReply(publish_ns=now_ns(), done=done, text=text[:2000], objects=objects.entries())
        query.reply(bus.keys.control, encode(reply))

    bus.session.declare_queryable(bus.keys.control, answer)
