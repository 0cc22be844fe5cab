"""Where the program keeps what it can make again, and how it writes a file: as a whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np

from huepose.support.errors import InputError


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/huepose`, or `~/.cache/huepose`."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "huepose"


def write_text(path: Path | str, text: str) -> None:
    """Write a file at once: a reader never sees a part of it. Makes missing folders. Raises InputError."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(name, 0o666 & ~umask)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise InputError(
            path, found=error.strerror or str(error), expected="a place that can be written"
        ) from None


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write an RGB picture (H, W, 3) uint8 as its ending says, PNG without one. Makes missing folders. Raises
    InputError."""
    import cv2

    ending = path.suffix.lower() or ".png"
    if not cv2.haveImageWriter(f"picture{ending}"):
        raise InputError(path, found="a picture that cannot be encoded", expected="an ending such as .png")
    data = cv2.imencode(ending, np.ascontiguousarray(picture[..., ::-1]))[1].tobytes()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    except OSError as error:
        raise InputError(path, found=error.strerror or str(error), fix="Choose another folder.") from None
