"""The zip of plain arrays that a reference model is stored in: every size is checked before memory is taken.

Entries are stored, never compressed, so no file can hold more than it has bytes.
"""

from __future__ import annotations

import json
import math
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.geometry.arrays import UInt8
from huepose.support.picture_size import picture_size

MAX_FILE_BYTES = 256 * 1024 * 1024
"""A reference model takes about 20 MB."""
MAX_TEXTURE_SIDE = 4096
"""Onboarding makes 1024 px at most."""
_MAX_HEADER_BYTES = 1024 * 1024


class Archive:
    """An opened file. Raises ValueError, or what zipfile and json raise, for one that is damaged."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            path.stat()  # says that there is none
            raise ValueError("it is no file")
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise ValueError(f"{size} bytes are more than a reference model has")
        self._zip = zipfile.ZipFile(path)
        entries = self._zip.infolist()
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
            self.close()
            raise ValueError("compressed entries")
        if sum(entry.file_size for entry in entries) > size:
            self.close()
            raise ValueError("entries that are larger than the file")

    def header(self) -> dict[str, Any]:
        """The values that are no arrays."""
        if self._zip.getinfo("header.json").file_size > _MAX_HEADER_BYTES:
            raise ValueError("its header is too large")
        header = json.loads(self._zip.read("header.json"))
        if not isinstance(header, dict):
            raise ValueError("its header is no JSON object")
        return header

    def array(self, name: str, kind: str) -> np.ndarray:
        """An array as that type (numpy's name of it), which may be wider than the stored one."""
        wanted = np.dtype(kind)
        if wanted.kind not in "biuf" or wanted.itemsize > 8:
            raise ValueError(f"{name} is of no type of numbers: {kind[:20]}")
        entry = self._zip.getinfo(f"{name}.npy")
        with self._zip.open(entry) as file:
            version = np.lib.format.read_magic(file)
            read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
            shape, column_wise, stored = read[version](file)
            if stored.kind not in "biuf" or (column_wise and len(shape) > 1):
                raise ValueError(f"{name} is no plain array of numbers")
            if math.prod(shape) * stored.itemsize != entry.file_size - file.tell():
                raise ValueError(f"{name} has not the size that it states")
            array = np.frombuffer(file.read(), stored).reshape(shape)
        return np.array(array, dtype=wanted)

    def close(self) -> None:
        """Let go of the file."""
        self._zip.close()

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def picture(png: UInt8) -> UInt8:
    """Picture (H, W, 3) RGB of the bytes of a PNG. Raises ValueError when it is none, or too large."""
    size = picture_size(png.tobytes())
    if size is None:
        raise ValueError("its texture is no picture")
    if max(size) > MAX_TEXTURE_SIDE:
        raise ValueError(f"its texture has {size[0]} x {size[1]} pixels, over {MAX_TEXTURE_SIDE} a side")
    texture = cv2.imdecode(png, cv2.IMREAD_COLOR)
    if texture is None:
        raise ValueError("its texture is damaged")
    return np.ascontiguousarray(texture[..., ::-1]).astype(np.uint8)
