"""What systemd wants to hear of a service of Type=notify: one datagram to the socket that it names.

Nothing happens where there is no such socket. See sd_notify(3); no library is needed for it.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress


def notify(*assignments: str) -> bool:
    """Send assignments such as `READY=1`, `WATCHDOG=1`, `STATUS=waiting for the camera`, `STOPPING=1`.

    Returns whether there was someone to tell. Never raises: a service manager that is gone ends no worker."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
        sender.setblocking(False)
        sender.sendto("\n".join(assignments).encode(), address)
        return True
    return False


def watchdog_s() -> float | None:
    """After how many seconds without `WATCHDOG=1` systemd takes this process for hung; None: never."""
    text = os.environ.get("WATCHDOG_USEC", "")
    meant = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    return int(text) * 1e-6 if meant and text.isdigit() and int(text) > 0 else None
