"""Several jobs take turns at a few seats, step by step, so that all are done at about the same time.

Five objects on two threads, each done in one go, keep one thread idle for the time of a whole object at the
end. Here every job has a thread of its own, but works only while it has one of the seats, and gives that up
between two steps (`pass_on`) when it has had it for a while and another job waits: first come, first seated.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from typing import TypeVar

T = TypeVar("T")

SPELL_S = 0.004
"""A seat is kept for at least so long: to hand it over takes some hundredths of a millisecond."""


def in_turns(jobs: Sequence[Callable[[], T]], seats: int, spell_s: float = SPELL_S) -> list[T]:
    """What the jobs return, in their order, at most `seats` of them working at any time, each for `spell_s`
    seconds or more. Each runs in a copy of the caller's context; the first exception of any of them is raised
    when all have ended."""
    if seats <= 1 or len(jobs) <= 1:
        return [job() for job in jobs]
    table = _Table(seats, spell_s)
    contexts = [copy_context() for _ in jobs]
    tickets = [table.ticket() for _ in jobs]
    with ThreadPoolExecutor(len(jobs)) as pool:
        done = [
            pool.submit(context.run, table.seat, ticket, job)
            for context, ticket, job in zip(contexts, tickets, jobs, strict=True)
        ]
    return [future.result() for future in done]


def pass_on() -> None:
    """Between two steps of a job: let the one that waits longest have the seat, and wait for the next one.
    Nothing happens where nobody waits, or outside of `in_turns`."""
    table = _table.get()
    if table is not None:
        table.pass_on()


class _Table:
    """Seats, and who waits for one."""

    def __init__(self, seats: int, spell_s: float) -> None:
        self._spell_s = spell_s
        self._lock = threading.Lock()
        self._free = seats
        self._waiting: deque[threading.Event] = deque()
        self._since = threading.local()

    def ticket(self) -> threading.Event:
        """Set as soon as there is a seat for its owner."""
        ticket = threading.Event()
        with self._lock:
            if self._free:
                self._free -= 1
                ticket.set()
            else:
                self._waiting.append(ticket)
        return ticket

    def seat(self, ticket: threading.Event, job: Callable[[], T]) -> T:
        """Do a job when it is its turn."""
        self._wait(ticket)
        _table.set(self)
        try:
            return job()
        finally:
            with self._lock:
                if self._waiting:
                    self._waiting.popleft().set()
                else:
                    self._free += 1

    def pass_on(self) -> None:
        """Give up the seat for a while."""
        if time.perf_counter() - self._since.start < self._spell_s or not self._waiting:
            return
        ticket = threading.Event()
        with self._lock:
            self._waiting.append(ticket)
            self._waiting.popleft().set()
        self._wait(ticket)

    def _wait(self, ticket: threading.Event) -> None:
        ticket.wait()
        self._since.start = time.perf_counter()


_table: ContextVar[_Table | None] = ContextVar("table", default=None)
