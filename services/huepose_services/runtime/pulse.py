"""The heartbeat of a worker. Only the loop that does the work sends it: a worker that hangs is silent, and
its supervisor (`huepose up` or systemd) restarts it.

Under `huepose up` it goes through a pipe (HUEPOSE_READY_FD): dots while the loop runs, a `c` when it has to
wait for the compiler, and the line `ready` once. For systemd a worker has started when its loop runs: a
camera that is not plugged in must not delay the start of the computer.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress

from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.text import encodable


def notify(*assignments: str) -> bool:
    """Send systemd (sd_notify(3)) the state of a service of Type=notify: assignments such as `READY=1`,
    `WATCHDOG=1`, `STATUS=waiting for the camera`, `STOPPING=1`.

    Returns whether systemd listens. Never raises: a service manager that is gone must end no worker."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
        sender.setblocking(False)
        sender.sendto(encodable("\n".join(assignments)).encode(), address)
        return True
    return False


def watchdog_s() -> float | None:
    """After how many seconds without `WATCHDOG=1` this process counts as hung for systemd; None: never."""
    text = os.environ.get("WATCHDOG_USEC", "")
    meant = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    return int(text) * 1e-6 if meant and text.isdigit() and int(text) > 0 else None


READY_FD = "HUEPOSE_READY_FD"
BEAT_S = 0.2
"""The interval of heartbeats of a worker that works."""

COMPILING = b"c"
COMPILING_S = 300.0
"""How long systemd waits for a kernel that is compiled in the middle of the work."""


class Pulse:
    """`running()` when the loop begins, `ready()` once, `beat()` after every step, `compiling()` and
    `compiled()` around a kernel that is compiled within one, `stopping()` at the end."""

    def __init__(self) -> None:
        text = os.environ.get(READY_FD, "")
        self._pipe = int(text) if text.isdigit() else None
        if self._pipe is not None:
            os.set_blocking(self._pipe, False)
        limit_s = watchdog_s()
        self._watched_us = None if limit_s is None else round(limit_s * 1e6)
        self._every_ns = int(min(BEAT_S, (limit_s or 1.0) / 4.0) * SECOND)
        self._next_ns = 0

    def running(self) -> None:
        """The worker has all that it needs of this computer, and its loop begins."""
        notify("READY=1")

    def ready(self) -> None:
        """The worker can give results: for a camera, it has a good frame."""
        self._write(b"ready\n")
        notify("STATUS=ready")

    def beat(self) -> None:
        """The worker still works; sent at most five times a second."""
        now = now_ns()
        if now < self._next_ns:
            return
        self._next_ns = now + self._every_ns
        self._write(b".")
        if self._watched_us is not None:
            notify("WATCHDOG=1")

    def compiling(self) -> None:
        """The worker will be silent for as long as the compiler takes."""
        self._write(COMPILING)
        if self._watched_us is not None:
            notify(f"WATCHDOG_USEC={COMPILING_S * 1e6:.0f}")

    def compiled(self) -> None:
        """The worker goes on."""
        self._write(b".")
        if self._watched_us is not None:
            notify(f"WATCHDOG_USEC={self._watched_us}")

    def stopping(self) -> None:
        """The worker was asked to stop, or has nothing left to do."""
        notify("STOPPING=1")

    def _write(self, data: bytes) -> None:
        # A supervisor that does not read, or is gone, must not stop the work.
        if self._pipe is not None:
            with suppress(OSError):
                os.write(self._pipe, data)
