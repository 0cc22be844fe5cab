"""The clock of all workers: CLOCK_MONOTONIC of this machine, its offset to the wall clock, and checks of
timestamps."""

from __future__ import annotations

import time

from huepose_protos import WireError
from huepose_protos.local import boot_id
from huepose_protos.messages import Clock, CorrectionMessage, Message, PoseMessage

now_ns = time.monotonic_ns
SECOND = 1_000_000_000


def this_clock() -> Clock:
    """The clock of this boot, and its offset to Unix time now: the wall clock may be set at any time."""
    return Clock(clock_id=boot_id() or "unknown", realtime_offset_ns=time.time_ns() - time.monotonic_ns())


TOLERANCE_NS = SECOND
"""A camera's clock may run ahead by a little."""


def check_stamps(message: Message, now_ns: int) -> None:
    """Raises WireError for a message that was sent, or whose frame was captured, later than now. The workers
    share one clock, so it is not from this pipeline, and it would stay the newest message for long."""
    for name in ("publish_ns", "capture_ns"):
        _check(name, getattr(message, name, None), now_ns)


def check_number(message: CorrectionMessage | PoseMessage, now_ns: int) -> None:
    """The same for the number of a correction (the time when it was made), or of the one that a pose
    contains."""
    if isinstance(message, CorrectionMessage):
        _check("seq", message.seq, now_ns)
    else:
        _check("applied_correction_seq", message.applied_correction_seq, now_ns)


def _check(name: str, value: int | None, now_ns: int) -> None:
    if value is not None and value > now_ns + TOLERANCE_NS:
        raise WireError(f"{name} {value} is {(value - now_ns) * 1e-9:.1f} s from now")
