"""Which of the processes of a run of tests this is."""

from __future__ import annotations

import os

NUMBER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
"""From 0; also where there is one process alone."""

_FIRST_PORT, _PORTS, _PROCESSES = 20_000, 40_000, 16


def own_ports() -> range:
    """Ports that no other of the first processes of the run takes."""
    count = _PORTS // _PROCESSES
    first = _FIRST_PORT + NUMBER % _PROCESSES * count
    return range(first, first + count)
