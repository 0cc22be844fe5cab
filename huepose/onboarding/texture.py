"""Make one texture of at most 1024 x 1024 texels from all colours of a mesh file.

Vertex colours are baked into a small patch of texels for every triangle. Several materials are packed into
an atlas. Textures that are used beyond 0..1 are unrolled. Used texels are dilated over the seams, so that
no background bleeds in. Large textures are reduced with an area filter.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int32, Int64, UInt8
from huepose.geometry.shelves import on_shelves
from huepose.onboarding.mesh_files import LARGEST_TEXTURE
from huepose.onboarding.patches import LARGEST, equal_patches
from huepose.onboarding.raw_mesh import SIMPLIFY, Material, RawMesh, Wrap
from huepose.rendering.textures import mark_specks, triangle_areas
from huepose.support.errors import InputError

_MAX_REPEATS = 8  # tiles of an unrolled texture along an axis
_MAX_SLACK = 0.01  # texture coordinates outside 0..1, or a tile, by up to this mean its border
_PATCH = 16  # side of the patch of a material without texture, texels
# Texture coordinates of its triangles in the patch: they cover some texels, because others have no colour.
_IN_PATCH = np.array([[0.4, 0.4], [0.6, 0.4], [0.5, 0.6]], np.float32)
_MAX_OVERLAP = 64  # area of all triangles over that of the texture
_MAX_MATERIALS = 4096  # an atlas has room for some ten thousand without texture
_MARGIN = 4  # texels between the materials of an atlas


def single_texture(raw: RawMesh, path: Path) -> tuple[Float32, UInt8]:
    """Texture coordinates (F, 3, 2) and texture (H, W, 3) uint8 RGB of a mesh as read, as `geometry.Mesh`
    has them."""
    if len(raw.materials) > _MAX_MATERIALS:
        raise InputError(
            path,
            found=f"{len(raw.materials)} materials",
            expected=f"at most {_MAX_MATERIALS}",
            fix="Join materials in the modelling program and export again.",
        )
    textured = any(m.texture is not None for m in raw.materials)
    if raw.colors is not None and not textured:
        return _baked(raw.vertices, raw.faces, raw.colors, path)[:2]
    uv = np.zeros((len(raw.faces), 3, 2), np.float32) if raw.uv is None else raw.uv.copy()
    if not np.isfinite(uv).all():
        raise InputError(path, found="texture coordinates that are not numbers", fix="Export the mesh again.")
    pictures: list[UInt8] = []
    for i, material in enumerate(raw.materials):
        mine = raw.face_materials == i
        if material.texture is None and raw.colors is not None and _tell_more(raw.colors[mine], material):
            uv[mine], picture, baked = _baked(raw.vertices, raw.faces[mine], raw.colors[mine], path)
            pictures.append(reduced(picture, baked))
            continue
        if material.texture is None:
            pictures.append(np.full((_PATCH, _PATCH, 3), material.color, np.uint8))
            uv[mine] = _IN_PATCH
            continue
        uv[mine], picture = _unrolled(uv[mine], material.texture, material.wrap, path)
        pictures.append(reduced(picture, used_texels(uv[mine], *picture.shape[:2])))
    if len(pictures) == 1:
        return uv, pictures[0]
    return _atlas(uv, raw.face_materials, pictures)


def used_texels(uv: Float32, height: int, width: int) -> UInt8:
    """Mask (H, W) uint8 of the texels that triangles (F, 3, 2) touch; all texels if the triangles overlap
    so often that filling them would take too long."""
    if triangle_areas(uv).sum() > _MAX_OVERLAP:
        return np.ones((height, width), np.uint8)
    used = np.zeros((height, width), np.uint8)
    corners = np.round((uv * [width, height] - 0.5) * 16).astype(np.int32)
    for triangle in corners:
        cv2.fillConvexPoly(used, triangle, 1, shift=4)
    mark_specks(used, uv)
    return used


def reduced(texture: UInt8, used: UInt8) -> UInt8:
    """The texture with at most LARGEST texels a side; unused texels are filled from their neighbours."""
    height, width = texture.shape[:2]
    scale = min(1.0, LARGEST / max(height, width))
    if scale == 1.0 and used.all():
        return texture
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    weight = cv2.resize(used.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    planes = []
    for k in range(3):  # one at a time: all of a texture of 8192 x 8192 would need gigabytes
        plane = texture[..., k].astype(np.float32) * used
        planes.append(cv2.resize(plane, size, interpolation=cv2.INTER_AREA))
    colors = np.stack(planes, -1).reshape(size[1], size[0], 3)
    filled = _filled(colors.astype(np.float64), weight.reshape(size[1], size[0]).astype(np.float64))
    return np.clip(np.round(filled), 0, 255).astype(np.uint8)


def _filled(premultiplied: Float64, weight: Float64) -> Float64:
    """Colours (H, W, 3) with holes filled: where the weight is zero, the mean of the smallest neighbourhood
    with colours."""
    height, width = weight.shape
    known = weight > 1e-3
    own = premultiplied / np.maximum(weight, 1e-3)[..., None]
    if known.all() or not known.any() or max(height, width) == 1:
        return own
    half = ((width + 1) // 2, (height + 1) // 2)
    even = np.zeros((half[1] * 2, half[0] * 2, 4))
    even[:height, :width, :3] = own * known[..., None]
    even[:height, :width, 3] = known
    sums = even.reshape(half[1], 2, half[0], 2, 4).sum((1, 3))
    coarse = _filled(sums[..., :3], sums[..., 3])
    smooth = cv2.resize(coarse, (half[0] * 2, half[1] * 2), interpolation=cv2.INTER_LINEAR)
    return np.where(known[..., None], own, smooth[:height, :width])


def _tell_more(colors: UInt8, material: Material) -> bool:
    """Whether the colours (F, 3, 3) at corners say more than the material's colour. White does not:
    exporters write it if there are no colours."""
    return bool((colors != material.color).any() and (colors != 255).any())


def _baked(vertices: Float64, faces: Int32, colors: UInt8, path: Path) -> tuple[Float32, UInt8, UInt8]:
    """Colours (F, 3, 3) at corners baked into patches of texels: texture coordinates, texture, and the mask
    (H, W) of the texels with a colour."""
    layout = equal_patches(vertices, faces)
    if layout is None:
        raise InputError(
            path,
            found=f"{len(faces)} coloured triangles",
            expected=f"at most {LARGEST**2}",
            fix=f"{SIMPLIFY}, or give it a texture instead of colours at its vertices.",
        )
    corners = colors.astype(np.float64)
    texture = layout.baked(lambda faces, w: np.einsum("fk,fkc->fc", w, corners[faces]))
    return layout.uv, texture, layout.baked(lambda faces, _: np.ones((len(faces), 3)))[..., 0]


def _unrolled(uv: Float32, texture: UInt8, wrap: tuple[Wrap, Wrap], path: Path) -> tuple[Float32, UInt8]:
    """uv within 0..1, and the texture for them. If the texture repeats, triangles outside are moved by
    whole tiles; for triangles that cross tiles, the texture gets more tiles."""
    height, width = texture.shape[:2]
    slack = np.minimum(_MAX_SLACK, [1.0 / width, 1.0 / height])
    outside = ((uv < -slack) | (uv > 1 + slack)).any((1, 2))
    if not outside.any():
        return np.clip(uv, 0.0, 1.0), texture
    uv = uv.copy()
    for axis, kind in enumerate(wrap):
        uv[outside, :, axis] = _nearer(uv[outside, :, axis], kind, slack[axis])
    low = np.minimum(0, np.floor(uv.min((0, 1)) + slack))
    repeats = np.maximum(1, np.ceil(uv.max((0, 1)) - slack)) - low
    if repeats.max() > _MAX_REPEATS:
        raise InputError(
            path,
            found=f"texture coordinates that span {repeats.max():.0f} times their texture",
            expected=f"at most {_MAX_REPEATS}",
            fix="Bake the texture in the modelling program and export again.",
        )
    first, tiles = low.astype(int), repeats.astype(int)
    texels = height * width * int(tiles.prod())
    if texels > LARGEST_TEXTURE:
        scale = float(np.sqrt(LARGEST_TEXTURE / texels))
        size = (max(1, int(width * scale)), max(1, int(height * scale)))
        texture = np.asarray(cv2.resize(texture, size, interpolation=cv2.INTER_AREA), np.uint8)
    columns, rows = (_wrapped(*along) for along in zip(first, tiles, texture.shape[1::-1], wrap, strict=True))
    return np.clip((uv - first) / tiles, 0.0, 1.0).astype(np.float32), texture[rows[:, None], columns]


def _nearer(along: Float32, wrap: Wrap, slack: float) -> Float32:
    """Coordinates (F, 3) along an axis, moved as near to 0..1 as possible without changing what they
    show."""
    low, high = along.min(1, keepdims=True), along.max(1, keepdims=True)
    if wrap == "clamp":
        beyond = (low >= 1) | (high <= 0)
        return np.where(beyond, np.clip(along, 0.0, 1.0), along)
    period = 2.0 if wrap == "mirror" else 1.0
    tile = np.floor(low + np.minimum(slack, (high - low) / 2))  # a small one is in the tile of its centre
    return np.asarray(along - period * np.floor(tile / period), np.float32)


def _wrapped(first: int, tiles: int, size: int, wrap: Wrap) -> Int64:
    """For each texel of `tiles` tiles the texel, out of `size`, that it shows."""
    at = np.arange(first * size, (first + tiles) * size)
    if wrap == "clamp":
        return np.clip(at, 0, size - 1)
    mirrored = (wrap == "mirror") & (at // size % 2 == 1)
    return np.where(mirrored, size - 1 - at % size, at % size)


def _atlas(uv: Float32, face_materials: Int32, pictures: list[UInt8]) -> tuple[Float32, UInt8]:
    """Pack the textures of materials into an atlas by shelves; all are scaled down until it is small
    enough."""
    scale = 1.0
    while True:
        sizes = [tuple(max(2, round(s * scale)) for s in p.shape[:2]) for p in pictures]
        framed = [(h + 2 * _MARGIN, w + 2 * _MARGIN) for h, w in sizes]
        limit = max(max(w for _, w in framed), int(np.sqrt(sum(h * w for h, w in framed))) + 1)
        places, width, height = on_shelves(framed, limit)
        if max(width, height) <= LARGEST:
            break
        scale *= 0.95
    texture = np.zeros((height, width, 3), np.uint8)
    out = uv.copy()
    for i, (picture, (h, w), (x, y)) in enumerate(zip(pictures, sizes, places, strict=True)):
        small = cv2.resize(picture, (w, h), interpolation=cv2.INTER_AREA)
        texture[y : y + h + 2 * _MARGIN, x : x + w + 2 * _MARGIN] = cv2.copyMakeBorder(
            small, _MARGIN, _MARGIN, _MARGIN, _MARGIN, cv2.BORDER_REPLICATE
        )
        mine = face_materials == i
        out[mine] = (uv[mine] * [w, h] + [x + _MARGIN, y + _MARGIN]) / [width, height]
    return out.astype(np.float32), texture
