"""Threads that work on the parts of one task in parallel; compiled kernels release the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextvars import Context, copy_context
from threading import Barrier
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

Steps = Generator[None, None, R]
"""Work that may pause wherever it yields, and continue in another thread."""


class Pool:
    """A pool of `threads` threads; with one, the calling thread does the work."""

    def __init__(self, threads: int) -> None:
        self._threads = _started(threads) if threads > 1 else None

    def map(self, work: Callable[[T], R], parts: Sequence[T]) -> list[R]:
        """The result of `work` for each part, in their order. Stages in all threads reach the caller's
        listener."""
        if self._threads is None or len(parts) <= 1:
            return [work(part) for part in parts]
        contexts = [copy_context() for _ in parts]
        return list(self._threads.map(lambda context, part: context.run(work, part), contexts, parts))

    def map_steps(self, work: Callable[[T], Steps[R]], parts: Sequence[T]) -> list[R]:
        """`map` for work in steps. A free thread takes the next step of the part that has waited longest,
        so that all threads are busy to the end: three parts of two steps take two threads the time of 1.5
        parts, not 2."""
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
    """Do all steps of the work one after another, and return its result.

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
    """An executor with all its threads running. Started later, when memory is short, a thread may end
    before it reports that it runs, and the program would wait for it forever."""
    pool, together = ThreadPoolExecutor(threads), Barrier(threads)
    try:
        list(pool.map(lambda _: together.wait(), range(threads)))
    except RuntimeError:  # the system allows no more: those that wait for it must end with the program
        together.abort()
        raise
    return pool
