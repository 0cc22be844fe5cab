"""Threads that work on the parts of one question at the same time, as compiled kernels let them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from threading import Barrier
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


class Pool:
    """So many threads; with one, whoever asks does the work."""

    def __init__(self, threads: int) -> None:
        self._threads = _started(threads) if threads > 1 else None

    def map(self, work: Callable[[T], R], parts: Sequence[T]) -> list[R]:
        """What `work` gives for each part, in their order; listeners to stages hear all threads."""
        if self._threads is None or len(parts) <= 1:
            return [work(part) for part in parts]
        contexts = [copy_context() for _ in parts]
        return list(self._threads.map(lambda context, part: context.run(work, part), contexts, parts))


def _started(threads: int) -> ThreadPoolExecutor:
    """With all its threads: one that is started when memory is short may end before it says that it runs, and
    is waited for without end."""
    pool, together = ThreadPoolExecutor(threads), Barrier(threads)
    list(pool.map(lambda _: together.wait(), range(threads)))
    return pool
