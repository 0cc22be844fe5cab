"""Removes what killed workers have left in the folder of sockets: one that ends by itself removes its
own socket and the lock beside it."""

from __future__ import annotations

import fcntl
import os
import stat
import time
from collections.abc import Callable, Container
from contextlib import suppress
from pathlib import Path

from huepose_services.runtime.run_folder import is_private, is_taken

OLD_S = 60.0
"""Younger files may be of a worker that has made its lock and does not hold it yet."""


def sweep(folder: Path, spared: Callable[[], Container[int]]) -> None:
    """Remove the sockets and locks in a folder that no process holds. spared: the ports of pipelines that run
    now, whose workers may be between two lives; asked for each file right before it goes."""
    if not is_private(folder):
        return
    names = (path for path in folder.iterdir() if path.stem.isdigit() and path.suffix in ("", ".lock"))
    for port in sorted({int(path.stem) for path in names}):
        with suppress(OSError):  # it is held, or gone
            _remove(folder, port, spared)


def _remove(folder: Path, port: int, spared: Callable[[], Container[int]]) -> None:
    """Raises OSError for a socket that somebody holds."""
    name, lock = folder / str(port), folder / f"{port}.lock"
    held = None
    try:
        # Whoever opens the socket takes the same lock first.
        with suppress(FileNotFoundError):
            held = os.open(lock, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        kinds = {name: stat.S_ISSOCK, lock: stat.S_ISREG}
        found = {path: path.lstat() for path in kinds if os.path.lexists(path)}
        ours = all(kinds[path](status.st_mode) for path, status in found.items())
        old = time.time() - max((s.st_mtime for s in found.values()), default=0.0) > OLD_S
        if ours and old and not is_taken(folder, port) and port not in spared():
            for path in found:  # the lock last
                path.unlink(missing_ok=True)
    finally:
        if held is not None:
            os.close(held)
