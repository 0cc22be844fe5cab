"""What a worker keeps of each object, also of one that is first met, or added again, while it runs: of that a
thread reads it from disk, and the work goes on meanwhile."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import TypeVar

from huepose_protos.messages import ObjectsMessage
from huepose_services.runtime.bus import Bus

T = TypeVar("T")


class Met(Mapping[str, T]):
    """By the names of objects. `get` of a name that is not there has it loaded, once, and is None until then;
    anew where the list of objects says that it was added since, maybe with another model.

    load: from a name to what is kept, called in a thread, for one after the other; tell: told in a sentence,
    once, of an object that cannot be loaded, in that thread; lacks: what becomes of that object."""

    def __init__(
        self,
        bus: Bus,
        known: Mapping[str, T],
        load: Callable[[str], T],
        tell: Callable[[str], None],
        lacks: str,
    ) -> None:
        self._known, self._load, self._tell, self._lacks = dict(known), load, tell, lacks
        self._bus, self._list = bus, bus.inbox.ring(bus.keys.objects, wakes=False)
        self._added: dict[str, int] | None = None  # None: no list has come
        self._asked: dict[str, threading.Thread] = {}
        self._loaded: queue.SimpleQueue[tuple[threading.Thread, str, T]] = queue.SimpleQueue()
        self._one_loads = threading.Lock()

    def __getitem__(self, name: str) -> T:
        self._forget_added()
        while not self._loaded.empty():
            by, of, item = self._loaded.get()
            if self._asked.get(of) is by:
                self._known[of] = item
        if name not in self._known and name not in self._asked:
            self._asked[name] = threading.Thread(target=self._load_one, args=(name,), daemon=True)
            self._asked[name].start()
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._known))

    def __len__(self) -> int:
        return len(self._known)

    def _forget_added(self) -> None:
        """Of what was added since the first list, and what is still being loaded of it."""
        message = self._bus.take(self._list, ObjectsMessage)
        if message is None:
            return
        newest = {entry.object: entry.added for entry in message.objects}
        before = newest if self._added is None else self._added
        for name in [name for name, added in newest.items() if before.get(name) != added]:
            self._known.pop(name, None)
            self._asked.pop(name, None)
        self._added = before | newest

    def _load_one(self, name: str) -> None:
        try:
            with self._one_loads:
                self._loaded.put((threading.current_thread(), name, self._load(name)))
        except Exception as error:  # whatever it is, the work goes on without this object
            self._tell(f"{name} {self._lacks}: {str(error) or type(error).__name__}")
