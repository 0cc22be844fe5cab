"""The zip of plain arrays in which a reference model is stored. Every size is checked before memory is
allocated.

Entries are stored, never compressed, so a file cannot hold more than its own size. Large arrays are not
read but memory-mapped: the processes of a machine share them, and unused parts take no memory.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import mmap
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.geometry.arrays import UInt8
from huepose.support.kept import ALIGNMENT
from huepose.support.picture_size import picture_size

MAX_FILE_BYTES = 256 * 1024 * 1024
"""A reference model takes about 20 MB."""
MAX_TEXTURE_SIDE = 4096
"""Onboarding makes 1024 px at most."""
_MAX_HEADER_BYTES = 1024 * 1024
_MAX_ARRAY_HEADER_BYTES = 4096

MAPPED_BYTES = 64 * 1024
"""Arrays from this size on are mapped; smaller ones share their memory pages with others anyway."""

_LOCAL_HEADER = struct.Struct("<4s22xHH")
"""Header of an entry in a zip file: signature, length of its name, length of its extra field."""

_PADDING = 0xD935
"""The kind of extra field that only aligns the content (as Android's zipalign writes it)."""


class Archive:
    """An opened file. Raises ValueError, or what zipfile and json raise, if it is damaged."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            path.stat()  # raises FileNotFoundError if there is none
            raise ValueError("it is not a file")
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise ValueError(f"{size} bytes are more than a reference model has")
        with path.open("rb") as file:
            # A private mapping: what a process writes to its arrays, only that process reads.
            self._bytes = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
        self._zip = zipfile.ZipFile(path)
        entries = self._zip.infolist()
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
            self.close()
            raise ValueError("compressed entries")
        if sum(entry.file_size for entry in entries) > size:
            self.close()
            raise ValueError("entries larger than the file")

    def header(self) -> dict[str, Any]:
        """The values that are not arrays."""
        if self._zip.getinfo("header.json").file_size > _MAX_HEADER_BYTES:
            raise ValueError("its header is too large")
        header = json.loads(self._zip.read("header.json"))
        if not isinstance(header, dict):
            raise ValueError("its header is not a JSON object")
        return header

    def digest(self) -> str:
        """A digest of the names, sizes and checksums of all entries: another content has another digest."""
        entries = [(entry.filename, entry.file_size, entry.CRC) for entry in self._zip.infolist()]
        return hashlib.sha256(repr(entries).encode()).hexdigest()[:32]

    def array(self, name: str, kind: str) -> np.ndarray:
        """An array as this type (NumPy's name of it), which may be wider than the stored one. A large array
        of the stored type is mapped from the file. Such a file may be replaced, but not written to."""
        wanted = np.dtype(kind)
        if wanted.kind not in "biuf" or wanted.itemsize > 8:
            raise ValueError(f"{name} has a type that is not numeric: {kind[:20]}")
        stored_bytes = self._stored(f"{name}.npy")
        file = io.BytesIO(stored_bytes[:_MAX_ARRAY_HEADER_BYTES])
        version = np.lib.format.read_magic(file)
        read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        shape, column_wise, stored = read[version](file)
        if stored.kind not in "biuf" or (column_wise and len(shape) > 1):
            raise ValueError(f"{name} is not a plain array of numbers")
        if math.prod(shape) * stored.itemsize != len(stored_bytes) - file.tell():
            raise ValueError(f"{name} does not have the size that it states")
        array = np.frombuffer(stored_bytes, stored, offset=file.tell()).reshape(shape)
        if stored == wanted and array.nbytes >= MAPPED_BYTES and array.flags.aligned:
            return array
        return np.array(array, dtype=wanted)

    def _stored(self, name: str) -> memoryview:
        """The bytes of an entry, where they lie in the file."""
        entry = self._zip.getinfo(name)
        header = self._bytes[entry.header_offset : entry.header_offset + _LOCAL_HEADER.size]
        signature, name_length, extra_length = _LOCAL_HEADER.unpack(header)
        first = entry.header_offset + _LOCAL_HEADER.size + name_length + extra_length
        content = memoryview(self._bytes)[first : first + entry.file_size]
        if signature != b"PK\3\4" or len(content) != entry.file_size or zlib.crc32(content) != entry.CRC:
            raise ValueError(f"{name} is damaged")
        return content

    def close(self) -> None:
        """Close the file, and free the memory that reading it took; mapped arrays stay valid."""
        self._zip.close()
        self._bytes.madvise(mmap.MADV_DONTNEED)

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def aligned_entry(name: str, offset: int, time: tuple[int, int, int, int, int, int]) -> zipfile.ZipInfo:
    """An entry whose content starts at a multiple of 64 bytes if it is written at this offset."""
    entry = zipfile.ZipInfo(name, time)
    least = struct.calcsize("<HH")
    padding = -(offset + _LOCAL_HEADER.size + len(name.encode()) + least) % ALIGNMENT
    entry.extra = struct.pack("<HH", _PADDING, padding) + bytes(padding)
    return entry


def texture_of(png: UInt8) -> UInt8:
    """The image (H, W, 3) RGB in the bytes of a PNG. Raises ValueError if it is not an image, or too
    large."""
    size = picture_size(png.tobytes())
    if size is None:
        raise ValueError("its texture is not an image")
    if max(size) > MAX_TEXTURE_SIDE:
        raise ValueError(f"its texture has {size[0]} x {size[1]} pixels, over {MAX_TEXTURE_SIDE} a side")
    texture = cv2.imdecode(png, cv2.IMREAD_COLOR)
    if texture is None:
        raise ValueError("its texture is damaged")
    return np.ascontiguousarray(texture[..., ::-1]).astype(np.uint8)
