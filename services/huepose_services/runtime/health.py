"""What a worker reports about itself: its rate, its processing time, the age of its results."""

from __future__ import annotations

import os
import time
from collections import deque
from pathlib import Path

import numpy as np

from huepose_protos.fields import HealthState
from huepose_protos.messages import Estimates, FrameHeader, HealthMessage, PoseMessage
from huepose_services.runtime.clock import SECOND, now_ns, this_clock
from huepose_services.runtime.session import restarts
from huepose_services.runtime.text import encodable

_WINDOW_S = 5.0
_LONGEST_TEXT = 500
LOCKED_TEXT = (
    "much memory is locked: after each restart of the camera its readers keep the old pool of frames locked "
    "(eclipse-zenoh/zenoh#2787); restart this worker to free it"
)


class Health:
    """Counters and timings of a worker; `message()` is what it publishes once a second."""

    def __init__(self, worker: str) -> None:
        self.worker = worker
        self.state: HealthState = "starting"
        self._warnings: dict[str, str] = {}
        self.counters: dict[str, int] = {}
        self.shared_memory: bool | None = None
        self.drops = self.errors = 0
        self.last_error = ""
        self.picture = ""
        """For a camera: why nothing can be found in its images, or why no image comes."""
        self.much_locked_mib = 128.0
        self.camera_epoch: int | None = None
        self.frame_id: int | None = None
        self._work: deque[tuple[int, float, float | None]] = deque()
        self._start_ns = self._cpu_from_ns = now_ns()
        self._first_work_ns: int | None = None
        self._cpu_from = time.process_time()

    def count(self, name: str, by: int = 1) -> None:
        """Add to a counter."""
        self.counters[name] = self.counters.get(name, 0) + by

    def failed(self, text: str) -> None:
        """Count an exception in the work, or a refused message."""
        self.errors += 1
        self.last_error = encodable(text)[:_LONGEST_TEXT]

    def warn_while(self, what: str, text: str | None) -> None:
        """Set a warning; it lasts until this is called with None, or with another text."""
        if text is None:
            self._warnings.pop(what, None)
        else:
            self._warnings[what] = encodable(text)[:_LONGEST_TEXT]

    def worked_on(self, started_ns: int, what: FrameHeader | PoseMessage | Estimates) -> None:
        """Note that the work on a frame, or on a result computed from it, which began at started_ns, is done.
        The age of the result is known only if the frame's timestamp is of this computer's clock."""
        self.camera_epoch, self.frame_id = what.camera_epoch, what.frame_id
        if self._first_work_ns is None:
            self._first_work_ns = started_ns
        foreign = isinstance(what, FrameHeader) and what.clock.clock_id != this_clock().clock_id
        now = now_ns()
        age_ms = None if foreign else (now - what.capture_ns) * 1e-6
        self._work.append((now, (now - started_ns) * 1e-6, age_ms))
        while self._work and now - self._work[0][0] > _WINDOW_S * SECOND:
            self._work.popleft()

    def message(self) -> HealthMessage:
        """The worker's health now."""
        now = now_ns()
        locked_mib = _status_mib("VmLck")
        if locked_mib > self.much_locked_mib:
            self.warn_while("locked", LOCKED_TEXT)
        recent = [w for w in self._work if now - w[0] <= _WINDOW_S * SECOND]
        cpu = time.process_time()
        percent = 100.0 * (cpu - self._cpu_from) / max((now - self._cpu_from_ns) * 1e-9, 1e-3)
        self._cpu_from, self._cpu_from_ns = cpu, now
        working_s = 0.0 if self._first_work_ns is None else (now - self._first_work_ns) * 1e-9
        return HealthMessage(
            publish_ns=now,
            worker=self.worker,
            pid=os.getpid(),
            state=self.state,
            clock=this_clock(),
            uptime_s=(now - self._start_ns) * 1e-9,
            rate_hz=len(recent) / max(min(working_s, _WINDOW_S), 1.0),
            cpu_percent=max(percent, 0.0),
            memory_mib=_status_mib("VmRSS"),
            locked_mib=locked_mib,
            camera_epoch=self.camera_epoch,
            frame_id=self.frame_id,
            work_ms=_median_and_p99([w[1] for w in recent]),
            age_ms=_median_and_p99([w[2] for w in recent if w[2] is not None]),
            shared_memory=self.shared_memory,
            counters=dict(self.counters),
            warnings=list(self._warnings.values())[-32:],
            drops=self.drops,
            errors=self.errors,
            last_error=self.last_error,
            restarts=restarts(),
            picture=encodable(self.picture)[:_LONGEST_TEXT],
        )


def _median_and_p99(values: list[float]) -> tuple[float, float] | None:
    if not values:
        return None
    median, high = np.percentile(values, [50, 99])
    return float(median), float(high)


def _status_mib(name: str) -> float:
    """A figure of /proc/self/status, which is in KiB."""
    try:
        text = Path("/proc/self/status").read_text()
        return next(int(line.split()[1]) for line in text.splitlines() if line.startswith(name)) / 1024.0
    except (OSError, StopIteration, ValueError):
        return 0.0
