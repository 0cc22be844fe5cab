"""The folder of this user's pipelines: their sockets, and notes of what runs. Only its user can open it.

Pipelines of a service manager have `/run/huepose`, which only root can have made; root and their own user
find them there.
"""

from __future__ import annotations

import os
import socket
import stat
from pathlib import Path

from huepose.support.errors import InputError
from huepose_protos.local import FOLDER, run_folder
from huepose_services.runtime.text import encodable

SYSTEM_FOLDER = Path("/run/huepose")
_LONGEST_PATH = 100
"""A socket's path has at most 107 bytes; a lock file beside it has five more."""


def is_private(folder: Path) -> bool:
    """Whether a folder belongs to this user, and nobody else can open it."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o077


def make_folder() -> Path:
    """The folder, made if it is missing. Raises InputError if it cannot be made, or is another user's."""
    folder = run_folder().absolute()
    found = ""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not folder.is_symlink() and folder.stat().st_uid == os.getuid():
            folder.chmod(0o700)
    except OSError as error:
        found = error.strerror or str(error)
    path = os.fsencode(folder)
    if len(path) > _LONGEST_PATH - len("/65535"):
        found = f"a path of {len(path)} bytes, which is too long for sockets"
    elif encodable(str(folder)) != str(folder) or {"?", "#"} & set(str(folder)):  # zenoh's separators
        found = "a path with characters that the address of a socket cannot have"
    if found or not is_private(folder):
        raise InputError(
            f"folder {folder} for the workers' sockets",
            found=found or "another user's, or a link",
            expected="a folder that is this user's own",
            fix=f"Set {FOLDER} to one, for all that belongs to the pipeline.",
        )
    return folder


def known_folders() -> list[Path]:
    """The folders with notes of pipelines that this user may read."""
    own = run_folder()
    folders = [own] if is_private(own) else []
    if own != SYSTEM_FOLDER and os.access(SYSTEM_FOLDER, os.R_OK | os.X_OK):
        folders.append(SYSTEM_FOLDER)
    return folders


def is_taken(folder: Path, port: int) -> bool:
    """Whether a process listens on the socket of this port."""
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(folder / str(port)))
        except BlockingIOError:
            return True  # it listens, but is busy
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
