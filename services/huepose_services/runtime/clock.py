"""The one clock: CLOCK_MONOTONIC of this machine, and how it relates to the wall's."""

from __future__ import annotations

import time
from functools import cache
from pathlib import Path

from huepose_protos.messages import Clock

now_ns = time.monotonic_ns
SECOND = 1_000_000_000


@cache
def this_clock() -> Clock:
    """The clock of this boot; the offset to Unix time is read once a process, since it is a label only."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        boot = "unknown"
    return Clock(clock_id=boot or "unknown", realtime_offset_ns=time.time_ns() - time.monotonic_ns())
