"""Writers of mesh files, to test the readers with."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import cv2
import numpy as np

from huepose.geometry import Mesh


def write_png(path: Path, rgb: np.ndarray) -> None:
    assert cv2.imwrite(str(path), rgb[..., ::-1])


def png_bytes(rgb: np.ndarray) -> bytes:
    return cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))[1].tobytes()


def write_obj(path: Path, mesh: Mesh, scale: float = 1000.0, texture_name: str | None = None) -> None:
    """OBJ, MTL and PNG, faces as v/vt."""
    texture_name = texture_name or f"{path.stem}.png"
    lines = [f"mtllib {path.stem}.mtl", "usemtl print"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices.astype(float) * scale]
    lines += [f"vt {u:.9g} {1 - v:.9g}" for u, v in mesh.uv.reshape(-1, 2).astype(float)]
    for k, face in enumerate(mesh.faces):
        lines.append("f " + " ".join(f"{v + 1}/{3 * k + i + 1}" for i, v in enumerate(face)))
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".mtl").write_text(f"newmtl print\nKd 1 1 1\nmap_Kd {texture_name}\n")
    write_png(path.parent / texture_name, mesh.texture)


def write_ply(
    path: Path, mesh: Mesh, *, binary: bool, lists: bool, scale: float = 1000.0, order: str = "<"
) -> None:
    """PLY with its texture: `lists` as MeshLab's texcoord lists of faces, else BOP's texture_u and texture_v
    of vertices (which are then doubled)."""
    texture = f"{path.stem}.png"
    write_png(path.parent / texture, mesh.texture)
    uv = mesh.uv.astype(np.float64) * [1, -1] + [0, 1]
    if lists:
        vertices, faces = mesh.vertices.astype(np.float64) * scale, mesh.faces
        properties = ["x", "y", "z"]
    else:
        corners = mesh.vertices[mesh.faces].reshape(-1, 3).astype(np.float64) * scale
        vertices = np.concatenate([corners, uv.reshape(-1, 2)], 1)
        faces = np.arange(3 * len(mesh.faces)).reshape(-1, 3)
        properties = ["x", "y", "z", "texture_u", "texture_v"]
    form = "ascii" if not binary else "binary_little_endian" if order == "<" else "binary_big_endian"
    header = ["ply", f"format {form} 1.0", f"comment TextureFile {texture}"]
    header += [f"element vertex {len(vertices)}", *(f"property float {p}" for p in properties)]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header += ["property list uchar float texcoord"] if lists else []
    text = "\n".join([*header, "end_header"]) + "\n"
    if not binary:
        rows = [" ".join(f"{x:.9g}" for x in row) for row in vertices]
        for face, t in zip(faces, uv, strict=True):
            row = "3 " + " ".join(map(str, face))
            rows.append(row + (" 6 " + " ".join(f"{x:.9g}" for x in t.reshape(-1)) if lists else ""))
        path.write_text(text + "\n".join(rows) + "\n")
        return
    body = vertices.astype(order + "f4").tobytes()
    for face, t in zip(faces, uv, strict=True):
        body += struct.pack(order + "B3i", 3, *face)
        body += struct.pack(order + "B6f", 6, *t.reshape(-1)) if lists else b""
    path.write_bytes(text.encode() + body)


def write_colored_ply(path: Path, vertices: np.ndarray, colors: np.ndarray, faces: list[list[int]]) -> None:
    """PLY, ascii, with colours per vertex and polygons of any length."""
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {p}" for p in "xyz"] + [
        f"property uchar {c}" for c in ("red", "green", "blue")
    ]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    pairs = zip(vertices, colors, strict=True)
    lines += [" ".join(f"{x:.9g}" for x in v) + " " + " ".join(map(str, c)) for v, c in pairs]
    lines += [f"{len(f)} " + " ".join(map(str, f)) for f in faces]
    path.write_text("\n".join(lines) + "\n")


def glb(tree: dict, chunk: bytes) -> bytes:
    """A binary glTF with this JSON tree and this binary chunk."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunk += b"\0" * (-len(chunk) % 4)
    total = 12 + 8 + len(text) + 8 + len(chunk)
    return (
        struct.pack("<4sII", b"glTF", 2, total)
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(chunk), b"BIN\0")
        + chunk
    )


class GlbWriter:
    """Collects arrays and images in one buffer."""

    def __init__(self) -> None:
        self.chunk = b""
        self.tree: dict = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], "images": []}
        self.tree |= {"textures": [], "materials": [], "meshes": [], "nodes": []}

    def view(self, data: bytes) -> int:
        self.chunk += b"\0" * (-len(self.chunk) % 4)
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.chunk), "byteLength": len(data)})
        self.chunk += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array: np.ndarray, kind: str) -> int:
        component = {"f4": 5126, "u2": 5123, "u4": 5125, "u1": 5121}[array.dtype.str[1:]]
        entry = {"bufferView": self.view(array.tobytes()), "componentType": component}
        entry |= {"count": len(array), "type": kind}
        if array.dtype.kind == "u" and kind != "SCALAR":
            entry["normalized"] = True
        self.tree["accessors"].append(entry)
        return len(self.tree["accessors"]) - 1

    def corners(self, mesh: Mesh) -> dict[str, int]:
        """Attributes of a mesh whose faces share no corner."""
        return {
            "POSITION": self.accessor(mesh.vertices[mesh.faces].reshape(-1, 3).astype("<f4"), "VEC3"),
            "TEXCOORD_0": self.accessor(mesh.uv.reshape(-1, 2).astype("<f4"), "VEC2"),
        }

    def textured_material(self, rgb: np.ndarray) -> int:
        image = {"bufferView": self.view(png_bytes(rgb)), "mimeType": "image/png"}
        self.tree["images"].append(image)
        self.tree["textures"].append({"source": len(self.tree["images"]) - 1})
        texture = {"index": len(self.tree["textures"]) - 1}
        self.tree["materials"].append({"pbrMetallicRoughness": {"baseColorTexture": texture}})
        return len(self.tree["materials"]) - 1

    def mesh(self, attributes: dict, **primitive: object) -> int:
        self.tree["meshes"].append({"primitives": [{"attributes": attributes, **primitive}]})
        return len(self.tree["meshes"]) - 1

    def write(self, path: Path, nodes: list[dict], roots: list[int]) -> None:
        tree = {k: v for k, v in self.tree.items() if v}
        tree |= {"nodes": nodes, "scenes": [{"nodes": roots}], "scene": 0}
        tree["buffers"] = [{"byteLength": len(self.chunk)}]
        path.write_bytes(glb(tree, self.chunk))


def write_glb(
    path: Path,
    mesh: Mesh,
    node: dict | None = None,
    sampler: dict | None = None,
    material: dict | None = None,
) -> None:
    """Write a textured mesh in metres under one node. `sampler` is that of the texture; `material` replaces
    the material whose base colour is the texture."""
    w = GlbWriter()
    attributes = w.corners(mesh)
    indices = w.accessor(np.arange(3 * len(mesh.faces)).astype("<u2"), "SCALAR")
    index = w.mesh(attributes, indices=indices, material=w.textured_material(mesh.texture))
    if sampler is not None:
        w.tree["samplers"] = [sampler]
        w.tree["textures"][0]["sampler"] = 0
    if material is not None:
        w.tree["materials"] = [material]
    w.write(path, [{"mesh": index, **(node or {})}], [0])


def write_gltf(folder: Path, mesh: Mesh, uv: tuple[str, np.ndarray] | None = None, **changes: object) -> Path:
    """A .gltf with buffer m.bin and texture print.png beside it; `uv`: the attribute name and
    the values (N, 2) of other texture coordinates; `changes` replace parts of the JSON tree."""
    w = GlbWriter()
    attributes = w.corners(mesh)
    if uv is not None:
        del attributes["TEXCOORD_0"]
        attributes[uv[0]] = w.accessor(uv[1].astype("<f4"), "VEC2")
    index = w.mesh(attributes, material=0)
    write_png(folder / "print.png", mesh.texture)
    (folder / "m.bin").write_bytes(w.chunk)
    tree = {k: w.tree[k] for k in ("asset", "bufferViews", "accessors", "meshes")}
    tree |= {"images": [{"uri": "print.png"}], "textures": [{"source": 0}], "buffers": [{"uri": "m.bin"}]}
    tree |= {"materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]}
    tree |= {"nodes": [{"mesh": index}], "scenes": [{"nodes": [0]}]}
    (folder / "m.gltf").write_text(json.dumps(tree | changes))
    return folder / "m.gltf"
