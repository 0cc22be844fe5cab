"""What a worker keeps of each object, also of one that is first met while it runs: of that a thread reads it
from disk, and the work goes on meanwhile."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from typing import TypeVar

T = TypeVar("T")


class Met(Mapping[str, T]):
    """By the names of objects. `get` of a name that is not there has it loaded, once, and is None until then.

    load: from a name to what is kept, called in a thread, for one after the other; tell: told in a sentence,
    once, of an object that cannot be loaded, in that thread; lacks: what becomes of that object."""

    def __init__(
        self, known: Mapping[str, T], load: Callable[[str], T], tell: Callable[[str], None], lacks: str
    ) -> None:
        self._known, self._load, self._tell, self._lacks = dict(known), load, tell, lacks
        self._asked: set[str] = set()
        self._one_loads = threading.Lock()

    def __getitem__(self, name: str) -> T:
        if name not in self._known and name not in self._asked:
            self._asked.add(name)
            threading.Thread(target=self._load_one, args=(name,), daemon=True).start()
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._known))

    def __len__(self) -> int:
        return len(self._known)

    def _load_one(self, name: str) -> None:
        try:
            with self._one_loads:
                self._known[name] = self._load(name)
        except Exception as error:  # whatever it is, the work goes on without this object
            self._tell(f"{name} {self._lacks}: {str(error) or type(error).__name__}")
