"""Ports for a pipeline of one's own, beside whatever runs here already."""

from __future__ import annotations

import os

from huepose.support.errors import InputError
from huepose_services.runtime.run_folder import is_taken, make_folder


def free_ports(count: int) -> int:
    """The first of `count` <= 16 ports in a row that nobody listens on. Raises InputError."""
    folder = make_folder()
    start = 20_000 + os.getpid() % 1000 * 16
    for base in range(start, 60_000, 16):
        if not any(is_taken(folder, base + place) for place in range(count)):
            return base
    raise InputError("ports 20000 to 60000", found="all taken", expected=f"{count} free ones in a row")
