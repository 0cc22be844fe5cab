"""What is made once for each object, and kept as long as that object lives."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

K = TypeVar("K")
V = TypeVar("V")


def once_for_each(make: Callable[[K], V]) -> Callable[[K], V]:
    """`make`, called once for each object: the result is kept until the object is gone, and threads that ask
    meanwhile wait for it.

    >>> class Mesh: ...
    >>> of, mesh = once_for_each(lambda mesh: object()), Mesh()
    >>> of(mesh) is of(mesh), of(mesh) is of(Mesh())
    (True, False)
    """
    results: WeakKeyDictionary[K, V] = WeakKeyDictionary()
    lock = threading.Lock()

    @wraps(make)
    def once(key: K) -> V:
        with lock:
            found = results.get(key)
            if found is None:
                found = results[key] = make(key)
            return found

    return once
