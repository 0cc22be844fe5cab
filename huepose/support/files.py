"""The cache folder, and how the program writes a file: completely or not at all."""

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
    """`$XDG_CACHE_HOME/huepose`, or `~/.cache/huepose`. Raises InputError if neither is known."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else home_folder("XDG_CACHE_HOME") / ".cache") / "huepose"


def home_folder(variable: str) -> Path:
    """The user's home folder. Raises InputError if there is none; variable: the environment variable with
    which the user can name another folder."""
    try:
        return Path.home()
    except RuntimeError:
        found, fix = "none: HOME is not set", f"Set HOME, or {variable} to a folder that can be written."
        raise InputError("the user's home folder", found=found, fix=fix) from None


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` to write to. At the end it replaces `path`, so that no process ever
    reads an incomplete file. An OSError from the disk names `path`."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        if error.filename in (None, str(part)):  # None after a write to an open file
            error.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def writing(
    place: Path | str, expected: str = "a place that can be written", fix: str = ""
) -> Iterator[None]:
    """An OSError inside the context becomes an InputError about `place`. But that the reader of a pipe has
    ended is no error of the place."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(place, found=error.strerror or str(error), expected=expected, fix=fix) from None


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, completely or not at all. A link or a device, and a file in a folder that is not
    writable, are written in place instead. Makes missing folders. Raises InputError."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        there = path.exists()
        if path.is_symlink() or (there and not (path.is_file() and os.access(path.parent, os.W_OK))):
            path.write_bytes(data)
            return
        with whole(path) as part:
            part.write_bytes(data)


def write_text(path: Path | str, text: str) -> None:
    """`write_bytes` for a text."""
    write_bytes(Path(path), text.encode())


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write an RGB picture (H, W, 3) uint8, or a grey one (H, W). The ending of the path says the format,
    PNG without one. Makes missing folders. Raises InputError."""
    import cv2
    import numpy as np

    ending = check_picture(path)
    bgr = picture if picture.ndim == 2 else picture[..., ::-1]
    data = cv2.imencode(ending, np.ascontiguousarray(bgr))[1].tobytes()
    write_bytes(path, data)


def check_picture(path: Path) -> str:
    """The ending of a picture's path, .png without one. Raises InputError if this format cannot be
    written."""
    import cv2

    ending = path.suffix.lower() or ".png"
    if not cv2.haveImageWriter(f"picture{ending}"):
        raise InputError(path, found="an image that cannot be encoded", expected="an ending such as .png")
    return ending


def check_place(path: Path, makes_folders: bool = True) -> None:
    """Raises InputError unless `path` can be written; call it before the work, not after it. makes_folders:
    whether the later write makes missing folders."""
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
    """Whether a file can be written, or a new file in a folder. Permissions alone are not enough: no user
    can make a file in /proc."""
    if not os.access(there, os.W_OK):
        return False
    if not there.is_dir():
        return True
    try:
        with TemporaryFile(dir=there):
            return True
    except OSError:
        return False
