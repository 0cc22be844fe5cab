"""glTF 2.0, as one binary file (GLB) or as .gltf with its parts: all meshes of the scene, merged.

Read are: POSITION, TEXCOORD, COLOR_0, indices, factor and texture of the base (or diffuse, or emissive)
colour, its wrap mode, and the transforms of the nodes. By the standard, lengths are metres and y is up;
axes are kept as in the file.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64, Int64, UInt8
from huepose.onboarding.gltf_asset import Asset, load_asset
from huepose.onboarding.mesh_files import MeshFiles
from huepose.onboarding.raw_mesh import RE_EXPORT, Material, RawMesh, Wrap, check_count, check_faces
from huepose.support.errors import InputError

_TRIANGLES, _STRIP, _FAN = 4, 5, 6  # modes of primitives that have faces
_MOST_NODES = 10_000  # or meshes, of a file
_TRANSFORM, _GLOSSY = "KHR_texture_transform", "KHR_materials_pbrSpecularGlossiness"
_INSTANCED = "EXT_mesh_gpu_instancing"
"""Without it, readers show one of many copies of a mesh."""
_WRAPS: dict[int, Wrap] = {33071: "clamp", 33648: "mirror", 10497: "repeat"}
_NEARLY_WHITE = 0.98  # of COLOR_0, which is linear: two levels of 255 less than white
_LOOKS = (
    "anisotropy",
    "clearcoat",
    "diffuse_transmission",
    "dispersion",
    "emissive_strength",
    "ior",
    "iridescence",
    "sheen",
    "specular",
    "transmission",
    "unlit",
    "variants",
    "volume",
    "volume_scatter",
)
"""Extensions KHR_materials_... that do not change the base colour of a material."""
_UNDERSTOOD = {
    *(f"KHR_materials_{name}" for name in _LOOKS),
    "EXT_lights_ies",
    "EXT_lights_image_based",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_xmp_json_ld",
    _TRANSFORM,
    _GLOSSY,
}
_COMPRESSED = {
    "EXT_meshopt_compression",
    "EXT_texture_avif",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_meshopt_compression",
    "KHR_texture_basisu",
    "MSFT_texture_dds",
}


def read_gltf(files: MeshFiles) -> RawMesh:
    """Mesh of a .glb or .gltf file. Raises InputError naming the file and what to do; for a damaged tree
    also LookupError, TypeError, ValueError and AttributeError."""
    asset = load_asset(files)
    foreign = set(asset.tree.get("extensionsRequired", [])) - _UNDERSTOOD
    foreign |= {_INSTANCED} & set(asset.tree.get("extensionsUsed", []))
    if foreign:
        fix = "Export again without it."
        if foreign & _COMPRESSED:
            fix = "Export again without compression (Draco, meshopt) and with PNG or JPEG textures."
        found = f"the extension {sorted(foreign & _COMPRESSED or foreign)[0]}"
        raise InputError(files.mesh, found=found, expected="plain glTF 2.0", fix=fix)
    return _merged(asset)


def _merged(asset: Asset) -> RawMesh:
    parts: list[tuple[Float64, Int64, Float64 | None, Float64 | None, int]] = []
    path = asset.files.mesh
    primitives, names = _placed_primitives(asset)
    for T, primitive in primitives:
        faces = _faces(asset, primitive)
        if not len(faces):
            continue
        attributes = primitive["attributes"]
        vertices = se3.apply(T, asset.accessor(attributes["POSITION"])[:, :3].astype(np.float64))
        faces = faces[:, ::-1] if np.linalg.det(T[:3, :3]) < 0 else faces
        material = primitive.get("material", -1)
        texture = _texture_entry(asset.tree, material)
        transform = texture.get("extensions", {}).get(_TRANSFORM, {})
        texcoord = f"TEXCOORD_{transform.get('texCoord', texture.get('texCoord', 0))}"
        check_faces(path, vertices, faces)
        where = asset.accessor(attributes[texcoord])[faces] if texcoord in attributes else None
        placed = None if where is None else _transformed(where, transform)
        colors = asset.accessor(attributes["COLOR_0"])[faces] if "COLOR_0" in attributes else None
        parts.append((vertices, faces, placed, colors, material))
    if not parts:
        raise InputError(path, found="no triangles in its scene", expected="a mesh", fix=RE_EXPORT)
    offsets = np.cumsum([0] + [len(p[0]) for p in parts])
    faces = np.concatenate([p[1] + o for p, o in zip(parts, offsets[:-1], strict=True)])
    used = sorted({p[4] for p in parts})
    materials = tuple(_material(asset, i) for i in used)
    for p in parts:
        if p[2] is None and materials[used.index(p[4])].texture is not None:
            raise InputError(
                path,
                found="a textured material on a mesh without texture coordinates",
                fix="Export again with texture coordinates (UVs) switched on.",
            )
        tinted = p[3] is not None and p[3][..., :3].min() < _NEARLY_WHITE
        if tinted and materials[used.index(p[4])].texture is not None:
            raise InputError(
                path,
                found="a texture and colours at vertices (COLOR_0), which multiply each other",
                expected="one of them on each part of the mesh",
                fix="Export again without vertex colours, or bake both into one texture.",
            )
    if all(p[3] is None for p in parts) and all(i < 0 for i in used):
        raise InputError(
            path, found="neither materials nor vertex colours", expected="a textured mesh", fix=RE_EXPORT
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
        names,
    )


def _placed_primitives(asset: Asset) -> tuple[list[tuple[Float64, dict[str, Any]]], tuple[str, ...]]:
    """Every primitive of the scene that has triangles, with its transform to the scene (4, 4); and the
    names of their meshes.

    Raises InputError for too many, before memory is allocated for them: many nodes may use one mesh.
    """
    path = asset.files.mesh
    nodes = max(len(asset.tree.get(kind, [])) for kind in ("nodes", "meshes"))
    if nodes > _MOST_NODES:
        raise InputError(
            path,
            found=f"{nodes} nodes or meshes",
            expected=f"at most {_MOST_NODES}",
            fix="Join the parts of the object and export again.",
        )
    triangles = 0
    out: list[tuple[Float64, dict[str, Any]]] = []
    names: list[str] = []
    for T, mesh, name in _placed_meshes(asset.tree):
        before = len(out)
        for primitive in asset.tree["meshes"][mesh]["primitives"]:
            if primitive.get("mode", 4) in (_TRIANGLES, _STRIP, _FAN):
                triangles += _size(asset.tree, primitive)
                check_count(path, triangles)
                out.append((T, primitive))
        names += [str(name)] * (len(out) > before)
    return out, tuple(names)


def _placed_meshes(tree: dict[str, Any]) -> list[tuple[Float64, int, str]]:
    """Every mesh of the scene with its transform to the scene (4, 4), which may scale, and its name."""
    nodes = tree.get("nodes", [])
    called = [entry.get("name") or f"mesh {i}" for i, entry in enumerate(tree.get("meshes", []))]
    if not nodes:
        return [(np.eye(4), i, name) for i, name in enumerate(called)]
    if tree.get("scenes"):
        roots = tree["scenes"][tree.get("scene", 0)].get("nodes", [])
    else:
        roots = sorted(set(range(len(nodes))) - {c for n in nodes for c in n.get("children", [])})
    out: list[tuple[Float64, int, str]] = []
    met: set[int] = set()
    stack = [(np.eye(4), i) for i in reversed(roots)]
    while stack:
        T_parent, i = stack.pop()
        if i in met:
            raise ValueError(f"node {i} is met twice, but nodes must form a tree")
        met.add(i)
        T = T_parent @ _node_transform(nodes[i])
        if "mesh" in nodes[i]:
            mesh = nodes[i]["mesh"]
            out.append((T, mesh, nodes[i].get("name") or called[mesh]))
        stack += [(T, c) for c in reversed(nodes[i].get("children", []))]
    return out


def _node_transform(node: dict[str, Any]) -> Float64:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    R = se3.rotation_from_quaternion(np.array(node.get("rotation", [0, 0, 0, 1]), np.float64))
    scale = np.array(node.get("scale", [1, 1, 1]), np.float64)
    return se3.make(R * scale, np.array(node.get("translation", [0, 0, 0]), np.float64))


def _size(tree: dict[str, Any], primitive: dict[str, Any]) -> int:
    """Upper bound of the triangles of a primitive, at least a third of its vertices."""
    vertices = int(tree["accessors"][primitive["attributes"]["POSITION"]]["count"])
    corners = int(tree["accessors"][primitive["indices"]]["count"]) if "indices" in primitive else vertices
    return max(corners if primitive.get("mode", 4) != _TRIANGLES else corners // 3, vertices // 3)


def _faces(asset: Asset, primitive: dict[str, Any]) -> Int64:
    """Triangles (F, 3) of a primitive."""
    index: Int64
    if "indices" in primitive:
        index = asset.accessor(primitive["indices"])[:, 0].astype(np.int64)
    else:
        index = np.arange(asset.tree["accessors"][primitive["attributes"]["POSITION"]]["count"])
    mode = primitive.get("mode", 4)
    if mode == _TRIANGLES:
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    if mode == _STRIP:
        strip = np.stack([index[:-2], index[1:-1], index[2:]], 1)
        strip[1::2] = strip[1::2, ::-1]
        return strip
    return np.stack([np.full(max(len(index) - 2, 0), index[:1]), index[1:-1], index[2:]], 1)


def _transformed(uv: Float64, transform: dict[str, Any]) -> Float64:
    """Texture coordinates (F, 3, 2) after the scale, rotation and offset of KHR_texture_transform."""
    angle = float(transform.get("rotation", 0.0))
    cosine, sine = np.cos(angle), np.sin(angle)
    u, v = np.moveaxis(uv * np.array(transform.get("scale", [1.0, 1.0])), -1, 0)
    rotated: Float64 = np.stack([cosine * u + sine * v, cosine * v - sine * u], -1)
    return np.asarray(rotated + np.array(transform.get("offset", [0.0, 0.0])))


def _base(material: dict[str, Any]) -> tuple[dict[str, Any], list[float]]:
    """Texture and factor of a material's base colour; if it has none, of its diffuse colour; if that is
    black, of its emissive colour: some exporters put all colours there."""
    base = material.get("pbrMetallicRoughness", {})
    diffuse = material.get("extensions", {}).get(_GLOSSY, {})
    if "baseColorTexture" not in base and ("diffuseTexture" in diffuse or "baseColorFactor" not in base):
        texture, factor = diffuse.get("diffuseTexture", {}), diffuse.get("diffuseFactor", [1, 1, 1, 1])
    else:
        texture, factor = base.get("baseColorTexture", {}), base.get("baseColorFactor", [1, 1, 1, 1])
    if not texture and not any(factor[:3]) and "emissiveTexture" in material:
        light = material.get("emissiveFactor", [0, 0, 0])
        texture, factor = material["emissiveTexture"], [*(light if any(light) else [1, 1, 1]), *factor[3:]]
    return dict(texture), factor


def _texture_entry(tree: dict[str, Any], material: int) -> dict[str, Any]:
    return _base(tree["materials"][material])[0] if material >= 0 else {}


def _material(asset: Asset, index: int) -> Material:
    if index < 0:
        return Material("", (255, 255, 255))
    entry = asset.tree["materials"][index]
    reference, whole = _base(entry)
    factor, opaque = np.array(whole[:3], float), entry.get("alphaMode", "OPAQUE") == "OPAQUE"
    r, g, b = (int(x) for x in _srgb(factor))
    texture, sampler = None, dict[str, Any]()
    if reference:
        source_entry = asset.tree["textures"][reference["index"]]
        if source_entry.get("source") is None:
            raise InputError(
                asset.files.mesh,
                found="a texture without PNG or JPEG image",
                expected="a plain image",
                fix="Export again with PNG or JPEG textures (not KTX2 or WebP).",
            )
        texture = asset.image(source_entry["source"])
        sampler = asset.tree["samplers"][source_entry["sampler"]] if "sampler" in source_entry else sampler
        if not asset.files.textured and opaque:
            texture = np.zeros((1, 1, 3), np.uint8)  # black: opaque
        if (factor != 1.0).any():
            tables = _srgb(_linear(np.arange(256, dtype=np.uint8))[:, None] * factor)
            texture = np.stack([tables[texture[..., c], c] for c in range(3)], -1)
    clear = not opaque and float(whole[3]) < 0.5
    u, v = (_WRAPS.get(sampler.get(axis, 0), "repeat") for axis in ("wrapS", "wrapT"))
    return Material(entry.get("name", f"material {index}"), (r, g, b), texture, clear, (u, v))


def _corner_colors(colors: Float64 | None, count: int, material: Material) -> UInt8:
    """sRGB colours (F, 3, 3) of corners: COLOR_0, which is linear, times the material's base colour."""
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
