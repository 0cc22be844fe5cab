"""Time spent in named stages; without a listener they cost nothing.

    with listening() as clock:
        estimator.estimate(frame, queries)
    clock.totals()   # {"masks": (wall_s, cpu_s), ...} of all stages that ran in this context meanwhile

Measured are wall time and the CPU time of the calling thread. It includes compiled kernels: they are
single-threaded.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class StageClock:
    """Seconds by stage: `spans[name]` is a list of (wall, cpu) in order."""

    def __init__(self) -> None:
        self.spans: dict[str, list[tuple[float, float]]] = {}

    def ended(self, name: str, wall_s: float, cpu_s: float) -> None:
        """Add the times of a stage that has ended."""
        self.spans.setdefault(name, []).append((wall_s, cpu_s))

    def totals(self) -> dict[str, tuple[float, float]]:
        """Sum of wall and CPU seconds by stage, in order of first appearance."""
        return {name: (sum(w for w, _ in s), sum(c for _, c in s)) for name, s in self.spans.items()}


_listener: ContextVar[StageClock | None] = ContextVar("stage_clock", default=None)


@contextmanager
def listening(clock: StageClock | None = None) -> Iterator[StageClock]:
    """Collect the times of the stages that run in this context, in `clock` or in a new StageClock."""
    clock = clock or StageClock()
    token = _listener.set(clock)
    try:
        yield clock
    finally:
        _listener.reset(token)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Measure what runs inside as a named stage; without a listener this only reads a variable."""
    clock = _listener.get()
    if clock is None:
        yield
        return
    wall, cpu = time.perf_counter(), time.thread_time()
    try:
        yield
    finally:
        clock.ended(name, time.perf_counter() - wall, time.thread_time() - cpu)
