"""The size of an image, read from its first bytes: a small file can hold more pixels than fit into memory.

>>> picture_size(b"no picture") is None
True
"""

from __future__ import annotations

import struct

from huepose.support.errors import InputError

MAX_PIXELS = 2**26
"""Largest image of a camera, or texture: 8192 x 8192."""
_PNG = b"\x89PNG\r\n\x1a\n"
_NO_FRAME_MARKERS = (0xC4, 0xC8, 0xCC)


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of a PNG or a JPEG; None for other data, or if its beginning is damaged."""
    if data.startswith(_PNG):
        return struct.unpack_from(">II", data, 16) if len(data) >= 24 else None
    return _jpeg_size(data) if data.startswith(b"\xff\xd8") else None


def require_room(data: bytes, where: object) -> None:
    """Raises InputError for a PNG or a JPEG of more than MAX_PIXELS."""
    width, height = picture_size(data) or (0, 0)
    if width * height > MAX_PIXELS:
        found, fix = f"{width} x {height} pixels", "Make it smaller."
        raise InputError(where, found=found, expected=f"{MAX_PIXELS} at most", fix=fix)


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
        elif 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME_MARKERS:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None
