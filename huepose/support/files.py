"""Where the program keeps what it can make again, and how it writes a file: as a whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING

from huepose.support.errors import InputError

if TYPE_CHECKING:
    import numpy as np


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/huepose`, or `~/.cache/huepose`. Raises InputError where nobody says which."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else home_folder("XDG_CACHE_HOME") / ".cache") / "huepose"


def home_folder(variable: str) -> Path:
    """The user's. Raises InputError where there is none; variable: of the environment, it says where to put
    things instead."""
    try:
        return Path.home()
    except RuntimeError:
        found, fix = "none: HOME is not set", f"Set HOME, or {variable} to a folder that can be written."
        raise InputError("the user's home folder", found=found, fix=fix) from None


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A path beside this one to write to, which then takes its place: nobody ever reads a part of a file.
    What the disk refuses is an OSError that names this path."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        if error.filename in (None, str(part)):  # none where an open file was written to
            error.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def writing(
    place: Path | str, expected: str = "a place that can be written", fix: str = ""
) -> Iterator[None]:
    """What the disk refuses inside becomes an InputError about this place."""
    try:
        yield
    except OSError as error:
        raise InputError(place, found=error.strerror or str(error), expected=expected, fix=fix) from None


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all; in its place where it is a link or a device, which stays one, or
    where its folder takes nothing new. Makes missing folders. Raises InputError."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        there = path.exists()
        if path.is_symlink() or (there and not (path.is_file() and os.access(path.parent, os.W_OK))):
            path.write_bytes(data)
            return
        with whole(path) as part:
            part.write_bytes(data)


def write_text(path: Path | str, text: str) -> None:
    """The same with a text."""
    write_bytes(Path(path), text.encode())


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write an RGB picture (H, W, 3) uint8, or a grey one (H, W), as its ending says, PNG without one. Makes
    missing folders. Raises InputError."""
    import cv2
    import numpy as np

    ending = check_picture(path)
    bgr = picture if picture.ndim == 2 else picture[..., ::-1]
    data = cv2.imencode(ending, np.ascontiguousarray(bgr))[1].tobytes()
    write_bytes(path, data)


def check_picture(path: Path) -> str:
    """The ending of a picture's kind, PNG's without one. Raises InputError for one that cannot be written."""
    import cv2

    ending = path.suffix.lower() or ".png"
    if not cv2.haveImageWriter(f"picture{ending}"):
        raise InputError(path, found="a picture that cannot be encoded", expected="an ending such as .png")
    return ending


def check_place(path: Path, makes_folders: bool = True) -> None:
    """Raises InputError unless something can be written there: asked before the work, not after it.
    makes_folders: whether those that are missing are made then."""
    path = path.absolute()
    with writing(path):
        there = next(p for p in (path, *path.parents) if p.exists())
    if there != path and not there.is_dir():
        found = f"{there} is no folder"
    elif not makes_folders and not path.parent.is_dir():
        found = f"no folder {path.parent}"
    elif not _can_be_written(there):
        found = f"{there} cannot be written"
    else:
        return
    raise InputError(path, found=found, expected="a place that can be written")


def _can_be_written(there: Path) -> bool:
    """Whether a file, or something new in a folder, can be written. Permissions alone do not tell: no user
    can make anything in /proc."""
    if not os.access(there, os.W_OK):
        return False
    if not there.is_dir():
        return True
    try:
        with TemporaryFile(dir=there):
            return True
    except OSError:
        return False
