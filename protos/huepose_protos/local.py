"""Where the workers of a pipeline are reached on this machine: sockets in a folder that only their user can
open. Nobody else can send or read anything there; other users and machines read through the gateway.

The folder is `$HUEPOSE_RUN`, else `huepose` in `$XDG_RUNTIME_DIR`, else `/tmp/huepose-UID`.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

FOLDER = "HUEPOSE_RUN"
BASE_PORT = 17447
"""The default of `bus.base_port`."""
_LOOK_EVERY_NS = 1_000_000_000
"""How often the pipeline of a camera is looked up: it may be started later, or restarted."""
_START_TIME = 19
"""Place of `starttime` (proc(5), number 22) among the fields after a process's name in /proc/PID/stat, in
clock ticks since the boot."""


def run_folder() -> Path:
    """The folder of this user; it may be missing."""
    if own := os.environ.get(FOLDER):
        return Path(own)
    base = os.environ.get("XDG_RUNTIME_DIR")
    if base:
        return Path(base) / "huepose"
    # Not TMPDIR, which differs between shells and services: one user has one folder.
    return Path(f"/tmp/huepose-{os.getuid()}")  # noqa: S108  # make_folder refuses another user's


def endpoint(port: int, folder: Path | str | None = None) -> str:
    """The zenoh endpoint of a worker; its port is the name of its socket.

    >>> endpoint(17448, "/run/huepose")
    'unixsock-stream//run/huepose/17448'
    """
    return f"unixsock-stream/{Path(folder or run_folder()).absolute()}/{port}"


def pose_endpoints(base_port: int | None = None, folder: Path | str | None = None) -> list[str]:
    """Where poses are read on the pipeline's own machine, by its own user: at the tracker, and at the
    camera, which sends its mount.

    base_port: the pipeline's first port. Without it: the port of the only pipeline that runs, or the
    default if none runs (of several cameras that are started later, the first one has it). Raises
    ValueError if several run.

    >>> pose_endpoints(folder="/run/huepose")
    ['unixsock-stream//run/huepose/17448', 'unixsock-stream//run/huepose/17447']
    """
    port = _only_port(Path(folder or run_folder())) if base_port is None else base_port
    return [endpoint(port + 1, folder), endpoint(port, folder)]


def _only_port(folder: Path) -> int:
    running = sorted(set(_noted(folder)))
    if len(running) > 1:
        port, site, camera, *_ = running[0]
        fix = f"pose_endpoints({port})"
        if sum(note.is_of(site, camera) for note in running) == 1:
            fix += f', or PoseClient(None, site="{site}", camera="{camera}")'
        found = f"found {len(running)} pipelines that run here: {_listed(running)}"
        raise ValueError(f"pose_endpoints: {found}; expected one. Say which: {fix}")
    return running[0].base_port if running else BASE_PORT


def born_of(number: int) -> str:
    """Which process has this number now, as numbers are used again: `BOOT/TICKS`, its start time. Empty if
    none has it, or the kernel does not say."""
    try:
        said = Path(f"/proc/{number}/stat").read_text(errors="replace")
    except OSError:
        return ""
    return f"{boot_id()}/{said.rpartition(')')[2].split()[_START_TIME]}"


def writer_runs(note: Path) -> bool:
    """Whether the process that wrote a note about its pipeline still runs. The note's name begins with the
    process's number; `born` in the note says which process of that number; without it, any counts."""
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


class _Note(NamedTuple):
    """A running pipeline, from its note."""

    base_port: int
    site: str
    camera: str
    file: str
    elsewhere: bool = False
    """Whether its camera, and so its poses and objects, are at another computer."""

    def is_of(self, site: str, camera: str) -> bool:
        """Whether it is the pipeline of this camera; `*` is any."""
        return site in ("*", self.site) and camera in ("*", self.camera)


def _listed(notes: Iterable[_Note]) -> str:
    return ", ".join(f"{n.site}/{n.camera} at port {n.base_port} ({n.file})" for n in notes)


def _noted(folder: Path) -> Iterator[_Note]:
    """The pipelines that run with their sockets in a folder; a pipeline whose workers were started one by one
    comes once for each."""
    for path in sorted(folder.glob("*.json")):
        with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            said, port = json.loads(path.read_bytes()), int(path.stem.rpartition("-")[2])
            if writer_runs(path):
                elsewhere = "downlink" in said.get("workers", ()) and "downlink" not in said.get("far", ())
                names = str(said["site"]), str(said["camera"]), str(said.get("file", ""))
                yield _Note(port, *names, elsewhere)


class Whereabouts:
    """Where the pipeline of a camera runs on this machine as this user, from its note; it may be started
    later, or restarted. A second camera's pipeline has another port.

    site, camera: `*` is any. `port`: the pipeline's first port; the default if no pipeline runs at all,
    None if only others run. Raises ValueError if several pipelines match."""

    def __init__(self, site: str, camera: str) -> None:
        self._site, self._camera = site, camera
        self.port: int | None = None
        self._look()
        if self.port is None and self._matching():
            fix = f"Say which: by site and camera, or by its port, as {self._matching()[0].base_port}"
            raise ValueError(f"{self.absence()}; expected one. {fix}")

    def has_moved(self) -> bool:
        """Whether its port has changed since the last call; looks at most once a second."""
        before = self.port
        if time.monotonic_ns() >= self._look_ns:
            self._look()
        return self.port != before

    def absence(self) -> str | None:
        """That only other pipelines run here, or that several match, in words, as of the last look; else
        None."""
        matching, name = self._matching(), f"{self._site}/{self._camera}"
        ports = {note.base_port for note in matching}
        if len(ports) > 1 and self.port not in ports:
            return f"{len(ports)} pipelines of {name} run here: {_listed(matching)}"
        if matching or (self.port is not None and not self._running):
            return None
        others = f", only {_listed(self._running)}" if self._running else ""
        return f"no pipeline of {name} runs here{others}"

    def _look(self) -> None:
        self._look_ns = time.monotonic_ns() + _LOOK_EVERY_NS
        self._running = sorted(set(_noted(run_folder())))
        ports = {note.base_port for note in self._matching()}
        if len(ports) == 1:
            (self.port,) = ports
        elif self.port is None and not self._running:
            self.port = BASE_PORT

    def _matching(self) -> list[_Note]:
        return [note for note in self._running if note.is_of(self._site, self._camera)]


def why_only_noted(base_port: int, folder: Path) -> str | None:
    """Why nothing answers although a note says that a pipeline runs there, in a sentence; None without such a
    note."""
    note = next((note for note in _noted(folder) if note.base_port == base_port), None)
    if note is None:
        return None
    name = f"{note.site}/{note.camera}"
    if note.elsewhere:
        return perception_alone(name)
    return f"{name}, from {note.file}, is being started or stopped; its log says how far it is"


def perception_alone(name: str) -> str:
    """The message at the second computer of SITE/CAMERA to a user who looks for poses or objects."""
    return f"here {name} has perception only: ask the camera's computer for poses and objects"


@cache
def boot_id() -> str:
    """The identifier of this boot of this machine, and so of its monotonic clock; empty if not known."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""
