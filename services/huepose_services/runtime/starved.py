"""How long a process has had to wait for a processor, as the kernel counts it: on a busy computer a worker is
silent for longer, and hangs no more than before."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path


class Starved:
    """The waits of one process. pid: its number."""

    def __init__(self, pid: int) -> None:
        self._tasks = Path(f"/proc/{pid}/task")
        self._before = self._waits_ns()

    def since_last_s(self) -> float:
        """Seconds since this was last asked, or made, that the one of its threads which waited longest could
        have run and did not. 0 where the kernel does not count it; a stopped or sleeping thread waits for
        nothing."""
        before, self._before = self._before, self._waits_ns()
        return max((now - before.get(thread, now) for thread, now in self._before.items()), default=0) * 1e-9

    def _waits_ns(self) -> dict[str, int]:
        """Of each thread, the second figure of its schedstat (Linux, Documentation/scheduler/sched-stats)."""
        waits = {}
        # Threads end while this looks, and the process may be gone.
        with suppress(OSError):
            for task in self._tasks.iterdir():
                with suppress(OSError, ValueError, IndexError):
                    waits[task.name] = int((task / "schedstat").read_bytes().split()[1])
        return waits
