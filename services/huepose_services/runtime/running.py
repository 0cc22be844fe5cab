"""Which pipelines this user runs on this machine, so that `huepose poses` finds them without being told.

`huepose up` notes its first port in a folder that only the user can write; a note whose process is gone is
ignored and removed.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def _folder() -> Path:
    base = os.environ.get("XDG_RUNTIME_DIR")
    return Path(base) / "huepose" if base else Path(tempfile.gettempdir()) / f"huepose-{os.getuid()}"


def _is_mine(folder: Path) -> bool:
    try:
        status = folder.lstat()
    except OSError:
        return False
    return folder.is_dir() and status.st_uid == os.getuid() and not status.st_mode & 0o022


@contextmanager
def noted(base_port: int) -> Iterator[None]:
    """While a pipeline runs in this process. Without a folder to write, nobody finds it: that is all."""
    folder = _folder()
    note = folder / f"{os.getpid()}.port"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if _is_mine(folder):
            note.write_text(str(base_port))
    except OSError:
        pass
    try:
        yield
    finally:
        if _is_mine(folder):
            note.unlink(missing_ok=True)


def base_ports() -> list[int]:
    """First ports of the pipelines that run now."""
    folder = _folder()
    if not _is_mine(folder):
        return []
    ports = set()
    for note in folder.glob("*.port"):
        if note.stem.isdigit() and _runs(int(note.stem)):
            text = note.read_text()
            ports |= {int(text)} if text.isdigit() else set()
        else:
            note.unlink(missing_ok=True)
    return sorted(ports)


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
