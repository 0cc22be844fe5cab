"""Where the program keeps what it can make again, and how it writes a file: as a whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from huepose.support.errors import InputError

if TYPE_CHECKING:
    import numpy as np


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/huepose`, or `~/.cache/huepose`."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "huepose"


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A path beside this one to write to, which then takes its place: nobody ever reads a part of a file."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        part.replace(path)
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


def write_text(path: Path | str, text: str) -> None:
    """Write a file, whole or not at all. Makes missing folders. Raises InputError."""
    path = Path(path)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole(path) as part:
            part.write_text(text, encoding="utf-8")


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write an RGB picture (H, W, 3) uint8, or a grey one (H, W), as its ending says, PNG without one. Makes
    missing folders. Raises InputError."""
    import cv2
    import numpy as np

    ending = path.suffix.lower() or ".png"
    if not cv2.haveImageWriter(f"picture{ending}"):
        raise InputError(path, found="a picture that cannot be encoded", expected="an ending such as .png")
    bgr = picture if picture.ndim == 2 else picture[..., ::-1]
    data = cv2.imencode(ending, np.ascontiguousarray(bgr))[1].tobytes()
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
