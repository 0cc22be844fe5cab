"""glTF 2.0, as one binary file (GLB) or as .gltf with its parts: all meshes of the scene, merged.

Read: POSITION, TEXCOORD, COLOR_0, indices, the base colour's factor and texture, the nodes' transforms.
Lengths are metres and y is up by the standard; axes are kept as they are in the file.
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64, Int64, UInt8
from huepose.onboarding.raw_mesh import (
    RE_EXPORT,
    Material,
    RawMesh,
    check_faces,
    decode_texture,
    read_bytes,
    read_texture,
)
from huepose.support.errors import InputError

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_UNDERSTOOD = {"KHR_materials_unlit", "KHR_mesh_quantization", "KHR_materials_specular", "KHR_materials_ior"}


@dataclass
class _Asset:
    path: Path
    tree: dict[str, Any]
    buffers: list[bytes]

    def accessor(self, index: int) -> Any:
        """Values of an accessor (N, width), normalised integers as floats."""
        a = self.tree["accessors"][index]
        if "sparse" in a or "bufferView" not in a:
            raise InputError(
                self.path, found="a sparse accessor", expected="plain vertex data", fix=RE_EXPORT
            )
        view = self.tree["bufferViews"][a["bufferView"]]
        dtype, width = np.dtype(_COMPONENTS[a["componentType"]]), _WIDTHS[a["type"]]
        stride = view.get("byteStride", dtype.itemsize * width)
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        rows = np.ndarray(
            (a["count"], width), dtype, self.buffers[view["buffer"]], start, (stride, dtype.itemsize)
        )
        if a.get("normalized") and dtype.kind in "iu":
            return np.maximum(rows.astype(np.float64) / np.iinfo(dtype).max, -1.0)
        return rows

    def image(self, index: int) -> UInt8:
        """Picture of an image entry: from the buffer, a data URI, or a file beside the asset."""
        entry = self.tree["images"][index]
        if "bufferView" in entry:
            view = self.tree["bufferViews"][entry["bufferView"]]
            start = view.get("byteOffset", 0)
            data = self.buffers[view["buffer"]][start : start + view["byteLength"]]
        elif entry["uri"].startswith("data:"):
            data = _data_uri(entry["uri"])
        else:
            return read_texture(self.path.parent / unquote(entry["uri"]), self.path)
        return decode_texture(data, f"{self.path} image {index}")


def read_gltf(path: Path) -> RawMesh:
    """Mesh of a .glb or .gltf file. Raises InputError naming the file and what to do."""
    asset = _load(path)
    foreign = set(asset.tree.get("extensionsRequired", [])) - _UNDERSTOOD
    if foreign:
        raise InputError(
            path,
            found=f"the extension {sorted(foreign)[0]}",
            expected="plain glTF 2.0",
            fix="Export again without compression (Draco, meshopt) and with PNG or JPEG textures.",
        )
    try:
        return _merged(asset)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, found=f"broken glTF ({error!r})", fix=RE_EXPORT) from None


def _load(path: Path) -> _Asset:
    data = read_bytes(path, "mesh")
    chunk: bytes | None = None
    text = data
    if data[:4] == b"glTF":
        version, length = struct.unpack_from("<II", data, 4) if len(data) >= 12 else (0, 0)
        if version != 2 or length > len(data):
            found = f"version {version}" if version != 2 else f"{len(data)} of {length} bytes"
            raise InputError(path, found=found, expected="a whole binary glTF 2.0 file", fix=RE_EXPORT)
        at, text = 12, b""
        while at + 8 <= length:
            size, kind = struct.unpack_from("<II", data, at)
            if kind == 0x4E4F534A:
                text = data[at + 8 : at + 8 + size]
            elif kind == 0x004E4942 and chunk is None:
                chunk = data[at + 8 : at + 8 + size]
            at += 8 + size
    try:
        tree = json.loads(text)
    except ValueError:
        raise InputError(path, found="no glTF header", expected="glTF 2.0", fix=RE_EXPORT) from None
    buffers = []
    for entry in tree.get("buffers", []):
        uri = entry.get("uri")
        if uri is None:
            buffers.append(chunk or b"")
        elif uri.startswith("data:"):
            buffers.append(_data_uri(uri))
        else:
            buffers.append(read_bytes(path.parent / unquote(uri), "buffer", path))
    return _Asset(path, tree, buffers)


def _data_uri(uri: str) -> bytes:
    return base64.b64decode(uri.split(",", 1)[1])


def _merged(asset: _Asset) -> RawMesh:
    parts: list[tuple[Float64, Int64, Float64 | None, Float64 | None, int]] = []
    for T, mesh in _placed_meshes(asset.tree):
        for primitive in asset.tree["meshes"][mesh]["primitives"]:
            faces = _faces(asset, primitive)
            if faces is None:
                continue
            attributes = primitive["attributes"]
            vertices = asset.accessor(attributes["POSITION"])[:, :3].astype(np.float64)
            faces = faces[:, ::-1] if np.linalg.det(T[:3, :3]) < 0 else faces
            material = primitive.get("material", -1)
            texcoord = f"TEXCOORD_{_texture_entry(asset.tree, material).get('texCoord', 0)}"
            check_faces(asset.path, vertices, faces)
            uv = asset.accessor(attributes[texcoord])[faces] if texcoord in attributes else None
            colors = asset.accessor(attributes["COLOR_0"])[faces] if "COLOR_0" in attributes else None
            parts.append((se3.apply(T, vertices), faces, uv, colors, material))
    if not parts:
        raise InputError(asset.path, found="no triangles in its scene", expected="a mesh", fix=RE_EXPORT)
    offsets = np.cumsum([0] + [len(p[0]) for p in parts])
    faces = np.concatenate([p[1] + o for p, o in zip(parts, offsets[:-1], strict=True)])
    used = sorted({p[4] for p in parts})
    materials = tuple(_material(asset, i) for i in used)
    for p in parts:
        if p[2] is None and materials[used.index(p[4])].texture is not None:
            raise InputError(
                asset.path,
                found="a textured material on a mesh without texture coordinates",
                fix="Export again with texture coordinates (UVs) switched on.",
            )
    if all(p[3] is None for p in parts) and all(i < 0 for i in used):
        raise InputError(
            asset.path,
            found="neither materials nor vertex colours",
            expected="a textured mesh",
            fix=RE_EXPORT,
        )
    uv = [np.zeros((len(p[1]), 3, 2)) if p[2] is None else p[2] for p in parts]
    colors = None
    if any(p[3] is not None for p in parts):
        rows = [_corner_colors(p[3], len(p[1]), materials[used.index(p[4])]) for p in parts]
        colors = np.concatenate(rows)
    return RawMesh(
        np.concatenate([p[0] for p in parts]),
        faces.astype(np.int32),
        np.concatenate(uv).astype(np.float32) if any(p[2] is not None for p in parts) else None,
        colors,
        np.concatenate([np.full(len(p[1]), used.index(p[4])) for p in parts]).astype(np.int32),
        materials,
    )


def _placed_meshes(tree: dict[str, Any]) -> list[tuple[Float64, int]]:
    """Every mesh of the scene with its transform to the scene (4, 4), which may scale."""
    nodes = tree.get("nodes", [])
    if not nodes:
        return [(np.eye(4), i) for i in range(len(tree.get("meshes", [])))]
    if tree.get("scenes"):
        roots = tree["scenes"][tree.get("scene", 0)].get("nodes", [])
    else:
        roots = sorted(set(range(len(nodes))) - {c for n in nodes for c in n.get("children", [])})
    out: list[tuple[Float64, int]] = []
    stack = [(np.eye(4), i, 0) for i in reversed(roots)]
    while stack:
        T_parent, i, depth = stack.pop()
        if depth > 64:
            raise ValueError("nodes that contain themselves")
        T = T_parent @ _node_transform(nodes[i])
        if "mesh" in nodes[i]:
            out.append((T, nodes[i]["mesh"]))
        stack += [(T, c, depth + 1) for c in reversed(nodes[i].get("children", []))]
    return out


def _node_transform(node: dict[str, Any]) -> Float64:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    R = se3.rotation_from_quaternion(np.array(node.get("rotation", [0, 0, 0, 1]), np.float64))
    scale = np.array(node.get("scale", [1, 1, 1]), np.float64)
    return se3.make(R * scale, np.array(node.get("translation", [0, 0, 0]), np.float64))


def _faces(asset: _Asset, primitive: dict[str, Any]) -> Int64 | None:
    """Triangles (F, 3) of a primitive; None for points and lines."""
    index: Int64
    if "indices" in primitive:
        index = asset.accessor(primitive["indices"])[:, 0].astype(np.int64)
    else:
        index = np.arange(asset.tree["accessors"][primitive["attributes"]["POSITION"]]["count"])
    mode = primitive.get("mode", 4)
    if mode == 4:
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    if mode == 5:
        strip = np.stack([index[:-2], index[1:-1], index[2:]], 1)
        strip[1::2] = strip[1::2, ::-1]
        return strip
    if mode == 6:
        return np.stack([np.full(len(index) - 2, index[0]), index[1:-1], index[2:]], 1)
    return None


def _texture_entry(tree: dict[str, Any], material: int) -> dict[str, Any]:
    if material < 0:
        return {}
    entry = tree["materials"][material].get("pbrMetallicRoughness", {}).get("baseColorTexture", {})
    return dict(entry)


def _material(asset: _Asset, index: int) -> Material:
    if index < 0:
        return Material("", (255, 255, 255))
    entry = asset.tree["materials"][index]
    factor = np.array(entry.get("pbrMetallicRoughness", {}).get("baseColorFactor", [1, 1, 1, 1])[:3], float)
    r, g, b = (int(x) for x in _srgb(factor))
    texture = None
    reference = _texture_entry(asset.tree, index)
    if reference:
        source = asset.tree["textures"][reference["index"]].get("source")
        if source is None:
            raise InputError(
                asset.path,
                found="a texture without PNG or JPEG image",
                expected="a plain image",
                fix="Export again with PNG or JPEG textures (not KTX2 or WebP).",
            )
        texture = asset.image(source)
        if (factor != 1.0).any():
            texture = _srgb(_linear(texture) * factor)
    return Material(entry.get("name", f"material {index}"), (r, g, b), texture)


def _corner_colors(colors: Float64 | None, count: int, material: Material) -> UInt8:
    """COLOR_0 is linear, and multiplies the material's base colour."""
    base = _linear(np.array(material.color, np.uint8))
    if colors is None:
        return np.broadcast_to(_srgb(base), (count, 3, 3)).copy()
    return _srgb(colors[..., :3] * base)


def _srgb(linear: Any) -> UInt8:
    x = np.clip(np.asarray(linear, np.float64), 0.0, 1.0)
    y = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.round(255.0 * y).astype(np.uint8)


def _linear(srgb: UInt8) -> Float64:
    table = np.arange(256) / 255.0
    table = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)
    return np.asarray(table[srgb])
