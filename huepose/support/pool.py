"""Threads that work on the parts of one question at the same time, as compiled kernels let them."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextvars import Context, copy_context
from threading import Barrier
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

Steps = Generator[None, None, R]
"""Work that may be set aside wherever it yields, and goes on in another thread."""


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

    def map_steps(self, work: Callable[[T], Steps[R]], parts: Sequence[T]) -> list[R]:
        """The same for work in steps: a free thread takes the next step of the part that waited longest, so
        that all threads are busy to the end. Two threads need the time of 1.5 parts for three of two steps,
        not of 2."""
        if self._threads is None or len(parts) <= 1:
            return [finished(work(part)) for part in parts]
        threads, results = self._threads, [Future[R]() for _ in parts]

        def step(context: Context, steps: Steps[R], result: Future[R]) -> None:
            try:
                context.run(next, steps)
            except StopIteration as end:
                result.set_result(end.value)
            except BaseException as error:
                result.set_exception(error)
            else:
                threads.submit(step, context, steps, result)

        for part, result in zip(parts, results, strict=True):
            threads.submit(step, copy_context(), work(part), result)
        wait(results)
        return [result.result() for result in results]


def finished(steps: Steps[R]) -> R:
    """What work in steps gives, all of them one after the other.

    >>> def work():
    ...     yield
    ...     return 3
    >>> finished(work())
    3
    """
    result: list[R] = []

    def whole() -> Steps[None]:
        result.append((yield from steps))

    for _ in whole():
        pass
    return result[0]


def _started(threads: int) -> ThreadPoolExecutor:
    """With all its threads: one that is started when memory is short may end before it says that it runs, and
    is waited for without end."""
    pool, together = ThreadPoolExecutor(threads), Barrier(threads)
    list(pool.map(lambda _: together.wait(), range(threads)))
    return pool
