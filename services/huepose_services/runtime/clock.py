"""The one clock: CLOCK_MONOTONIC of this machine, and how it relates to the wall's."""

from __future__ import annotations

import time

from huepose_protos.local import boot_id
from huepose_protos.messages import Clock

now_ns = time.monotonic_ns
SECOND = 1_000_000_000


def this_clock() -> Clock:
    """The clock of this boot, and its offset to Unix time now: the wall's clock may be set at any time."""
    return Clock(clock_id=boot_id() or "unknown", realtime_offset_ns=time.time_ns() - time.monotonic_ns())
