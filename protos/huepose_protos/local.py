"""Where the workers of a pipeline are reached on this machine: sockets in a folder that only their user can
open. Nobody else can say or hear anything there; other users and machines read through the gateway.

The folder is `$HUEPOSE_RUN`, else `huepose` in `$XDG_RUNTIME_DIR`, else `/tmp/huepose-UID`.
"""

from __future__ import annotations

import json
import os
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

FOLDER = "HUEPOSE_RUN"
BASE_PORT = 17447
"""The first port where `bus.base_port` says nothing else."""
_START_TIME = 19
"""Of the fields after a process's name in /proc/PID/stat: `starttime` (proc(5), number 22), in clock ticks
since the boot."""


def run_folder() -> Path:
    """The folder of this user; it need not be there."""
    if own := os.environ.get(FOLDER):
        return Path(own)
    base = os.environ.get("XDG_RUNTIME_DIR")
    return Path(base) / "huepose" if base else Path(tempfile.gettempdir()) / f"huepose-{os.getuid()}"


def endpoint(port: int, folder: Path | str | None = None) -> str:
    """The zenoh endpoint of a worker; its port is the name of its socket.

    >>> endpoint(17448, "/run/huepose")
    'unixsock-stream//run/huepose/17448'
    """
    return f"unixsock-stream/{Path(folder or run_folder()).absolute()}/{port}"


def pose_endpoints(base_port: int = BASE_PORT, folder: Path | str | None = None) -> list[str]:
    """Where poses are read on the pipeline's own machine, by its own user: at the tracker, and at the camera,
    which says where it is.

    >>> pose_endpoints(folder="/run/huepose")
    ['unixsock-stream//run/huepose/17448', 'unixsock-stream//run/huepose/17447']
    """
    return [endpoint(base_port + 1, folder), endpoint(base_port, folder)]


def born_of(number: int) -> str:
    """Which of all processes that ever have this number has it now: `BOOT/TICKS`, when it was started. Empty
    where none has it, or nobody says."""
    try:
        said = Path(f"/proc/{number}/stat").read_text(errors="replace")
    except OSError:
        return ""
    return f"{boot_id()}/{said.rpartition(')')[2].split()[_START_TIME]}"


def writer_runs(note: Path) -> bool:
    """Whether the process that noted which pipeline it runs is there: the note's name begins with its
    number. `born` in it says which process of that number; where it is missing, any counts."""
    number = note.stem.partition("-")[0]
    if not number.isdigit():
        return False
    with suppress(OSError, ValueError, AttributeError):
        if born := json.loads(note.read_bytes()).get("born"):
            return bool(born == born_of(int(number)))
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def base_port_of(site: str, camera: str) -> int:
    """The first port of the pipeline of a camera that runs on this machine as this user, by what it notes of
    itself; where none does, the one that is usual. A second camera's pipeline has another one."""
    for note in sorted(run_folder().glob("*.json")):
        with suppress(OSError, ValueError, KeyError, TypeError):
            said = json.loads(note.read_bytes())
            if (said["site"], said["camera"]) == (site, camera) and writer_runs(note):
                return int(said["base_port"])
    return BASE_PORT


def note_of(base_port: int, folder: Path) -> str | None:
    """Of the pipeline that a process says that it runs there: SITE/CAMERA, from which file."""
    for note in folder.glob(f"*-{base_port}.json"):
        with suppress(OSError, ValueError, KeyError, TypeError):
            said = json.loads(note.read_bytes())
            if writer_runs(note):
                return f"{said['site']}/{said['camera']}, from {said['file']},"
    return None


@cache
def boot_id() -> str:
    """Which boot of which machine this is, and so whose monotonic clock; empty where nobody says."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""
