"""A glTF 2.0 asset: its tree, and the buffers and images that this names, from a GLB or a .gltf with its
parts."""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote

import numpy as np

from huepose.geometry.arrays import UInt8
from huepose.onboarding.mesh_files import MeshFiles
from huepose.onboarding.raw_mesh import RE_EXPORT
from huepose.support.errors import InputError

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_JSON, _BIN = 0x4E4F534A, 0x004E4942  # kinds of chunks


@dataclass(frozen=True)
class Asset:
    """tree: the JSON; buffers: its bytes, by number."""

    files: MeshFiles
    tree: dict[str, Any]
    buffers: list[bytes]

    def accessor(self, index: int) -> Any:
        """Values of an accessor (N, width), normalised integers as floats. Raises InputError for a sparse
        accessor, and other errors for a damaged tree."""
        a = self.tree["accessors"][index]
        if "sparse" in a or "bufferView" not in a:
            raise InputError(
                self.files.mesh, found="a sparse accessor", expected="plain vertex data", fix=RE_EXPORT
            )
        view = self.tree["bufferViews"][a["bufferView"]]
        dtype, width = np.dtype(_COMPONENTS[a["componentType"]]), _WIDTHS[a["type"]]
        row_bytes = dtype.itemsize * width
        stride = view.get("byteStride", row_bytes)
        if stride < row_bytes:  # overlapping rows would need far more memory than the file
            raise ValueError(f"a byteStride of {stride} for rows of {row_bytes} bytes")
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        rows = np.ndarray(
            (a["count"], width), dtype, self.buffers[view["buffer"]], start, (stride, dtype.itemsize)
        )
        if a.get("normalized") and dtype.kind in "iu":
            return np.maximum(rows.astype(np.float64) / np.iinfo(dtype).max, -1.0)
        return rows

    def image(self, index: int) -> UInt8:
        """The texture of an image entry: from the buffer, a data URI, or a file beside the asset."""
        entry = self.tree["images"][index]
        if "bufferView" in entry:
            view = self.tree["bufferViews"][entry["bufferView"]]
            start = view.get("byteOffset", 0)
            data = self.buffers[view["buffer"]][start : start + view["byteLength"]]
        elif entry["uri"].startswith("data:"):
            data = _data_uri(entry["uri"])
        else:
            return self.files.texture(unquote(entry["uri"]), self.files.mesh)
        return self.files.picture(data, f"{self.files.mesh} image {index}")


def load_asset(files: MeshFiles) -> Asset:
    """The asset of a .glb or .gltf file with its buffers. Raises InputError, and other errors for a damaged
    tree."""
    data = files.read_mesh()
    chunk = b""
    text = data
    if data[:4] == b"glTF":
        version, length = struct.unpack_from("<II", data, 4) if len(data) >= 12 else (0, 0)
        if version != 2 or length > len(data):
            found = f"version {version}" if version != 2 else f"{len(data)} of {length} bytes"
            raise InputError(files.mesh, found=found, expected="a whole binary glTF 2.0 file", fix=RE_EXPORT)
        chunks = _chunks(data, length)
        text, chunk = chunks.get(_JSON, b""), chunks.get(_BIN, b"")
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError):
        tree = None
    if not isinstance(tree, dict):
        raise InputError(files.mesh, found="no glTF header", expected="glTF 2.0", fix=RE_EXPORT)
    return Asset(files, tree, [_buffer(files, entry, chunk) for entry in tree.get("buffers", [])])


def _chunks(data: bytes, length: int) -> dict[int, bytes]:
    """The first chunk of each kind of a binary glTF file."""
    chunks: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if kind in (_JSON, _BIN):
            chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    return chunks


def _buffer(files: MeshFiles, entry: dict[str, Any], chunk: bytes) -> bytes:
    uri = entry.get("uri")
    if uri is None:
        return chunk
    if uri.startswith("data:"):
        return _data_uri(uri)
    return files.read(unquote(uri), "buffer", files.mesh)[1]


def _data_uri(uri: str) -> bytes:
    return base64.b64decode(uri.split(",", 1)[1])
