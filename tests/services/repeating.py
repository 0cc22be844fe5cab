"""An action that is repeated while a test looks at its results."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def repeating(act: Callable[[int], None], every_s: float) -> Iterator[None]:
    """Calls `act` in a thread of its own, with 1, 2, 3 and so on."""
    done = threading.Event()

    def repeat() -> None:
        number = 0
        while not done.wait(every_s):
            number += 1
            act(number)

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
