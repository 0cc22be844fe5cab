"""The folder of this user's pipelines: their sockets, notes of what runs, and what killed workers have left
there. Only its user can open it.

What a service manager runs has `/run/huepose`, which only root could have made; root and its own user find
the pipeline there.
"""

from __future__ import annotations

import fcntl
import os
import socket
import stat
import time
from collections.abc import Callable, Container
from contextlib import suppress
from pathlib import Path

from huepose.support.errors import InputError
from huepose_protos.local import FOLDER, run_folder

SYSTEM_FOLDER = Path("/run/huepose")
_LONGEST_PATH = 100
"""A socket's path has at most 107 bytes; a lock file beside it has five more."""


def is_private(folder: Path) -> bool:
    """Whether it is a folder of this user, and nobody else can open it."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o077


def make_folder() -> Path:
    """The folder, made when it is not there. Raises InputError where it cannot be, or is somebody else's."""
    folder = run_folder().absolute()
    found = ""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not folder.is_symlink() and folder.stat().st_uid == os.getuid():
            folder.chmod(0o700)
    except OSError as error:
        found = error.strerror or str(error)
    if len(str(folder)) > _LONGEST_PATH - len("/65535"):
        found = f"a path of {len(str(folder))} bytes, which is too long for sockets"
    if found or not is_private(folder):
        raise InputError(
            f"folder {folder} for the workers' sockets",
            found=found or "another user's, or a link",
            expected="a folder that is this user's own",
            fix=f"Set {FOLDER} to one, for all that belongs to the pipeline.",
        )
    return folder


def known_folders() -> list[Path]:
    """Where pipelines may be noted that this user may look at."""
    own = run_folder()
    folders = [own] if is_private(own) else []
    if own != SYSTEM_FOLDER and os.access(SYSTEM_FOLDER, os.R_OK | os.X_OK):
        folders.append(SYSTEM_FOLDER)
    return folders


def is_taken(folder: Path, port: int) -> bool:
    """Whether somebody listens on the socket of that name."""
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(folder / str(port)))
        except BlockingIOError:
            return True  # it listens, and has no time
        except OSError:
            return False
        return True


def free_tcp_port() -> int:
    """A port of this machine that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def free_ports(count: int) -> int:
    """The first of `count` <= 16 ports in a row that nobody listens on. Raises InputError."""
    folder = make_folder()
    start = 20_000 + os.getpid() % 1000 * 16
    for base in range(start, 60_000, 16):
        if not any(is_taken(folder, base + place) for place in range(count)):
            return base
    raise InputError("ports 20000 to 60000", found="all taken", expected=f"{count} free ones in a row")


OLD_S = 60.0
"""Younger files may be of a worker that has made its lock and does not hold it yet."""


def sweep(folder: Path, spared: Callable[[], Container[int]]) -> None:
    """Remove the sockets and locks in a folder that no process holds: a worker that ends by itself removes
    its own. spared: the ports of pipelines that run now, whose workers may be between two lives; asked for
    each file right before it goes."""
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
