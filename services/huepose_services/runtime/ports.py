"""Ports for a pipeline of one's own, beside whatever runs here already."""

from __future__ import annotations

import os
import socket

from huepose.support.errors import InputError


def free_ports(count: int) -> int:
    """The first of `count` <= 16 loopback ports in a row that nobody listens on. Raises InputError."""
    start = 20_000 + os.getpid() % 1000 * 16
    for base in range(start, 60_000, 16):
        if all(_is_free(base + i) for i in range(count)):
            return base
    raise InputError("ports 20000 to 60000", found="all taken", expected=f"{count} free ones in a row")


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True
