"""Texture pyramids, so that a small image of a fine texture does not alias.

Each level halves the one below. Only texels that lie on the surface are averaged, and the others are filled
from the coarser level, so that the blank between the charts of an unwrapped mesh does not bleed into the
texture.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64, Int32, Int64, UInt8
from huepose.geometry.mesh import Mesh
from huepose.rendering.raster import rasterise
from huepose.support.jit import jit

SPECK = 0.01
"""A triangle with less area than this in the texture, in texels, counts as having none: it has one colour,
as from a palette."""


@dataclass(frozen=True, eq=False)
class Pyramid:
    """texels (N, 3) uint8: all levels one after another, row by row; levels (L, 3) int64: offset of the first
    texel, height, width."""

    texels: UInt8
    levels: Int64


def build_pyramid(mesh: Mesh) -> Pyramid:
    """Pyramid of the texture of `mesh`, down to one texel."""
    height, width = mesh.texture.shape[:2]
    shapes = [(height, width)]
    while shapes[-1] != (1, 1):
        shapes.append((max(1, shapes[-1][0] // 2), max(1, shapes[-1][1] // 2)))
    sizes = np.array([h * w for h, w in shapes], np.int64)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    texels = np.empty((int(offsets[-1]), 3), np.uint8)
    texels[: offsets[1]] = mesh.texture.reshape(-1, 3)
    used = [covered_texels(mesh)]
    for level in range(1, len(shapes)):
        fine = texels[offsets[level - 1] : offsets[level]].reshape(*shapes[level - 1], 3)
        coarse = texels[offsets[level] : offsets[level + 1]].reshape(*shapes[level], 3)
        mask = np.empty(shapes[level], np.uint8)
        _halve(fine, used[-1], coarse, mask)
        used.append(mask)
    for level in range(len(shapes) - 2, -1, -1):
        fine = texels[offsets[level] : offsets[level + 1]].reshape(*shapes[level], 3)
        coarse = texels[offsets[level + 1] : offsets[level + 2]].reshape(*shapes[level + 1], 3)
        _fill_unused(fine, used[level], coarse)
    levels = np.array([[o, h, w] for o, (h, w) in zip(offsets[:-1], shapes, strict=True)], np.int64)
    return Pyramid(texels, levels)


def covered_texels(mesh: Mesh) -> UInt8:
    """Texels (H, W) that some face uses: 1, else 0. All of them if the texture repeats."""
    height, width = mesh.texture.shape[:2]
    if mesh.uv.min() < 0 or mesh.uv.max() > 1:
        return np.ones((height, width), np.uint8)
    size = np.array([width, height], np.float64)
    corners: Float64 = np.ones((mesh.uv.shape[0] * 3, 3))
    corners[:, :2] = mesh.uv.reshape(-1, 2) * size - 0.5
    faces: Int32 = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    inverse: Float32 = np.zeros((height, width), np.float32)
    face, owner = np.zeros((height, width), np.int32), np.zeros((height, width), np.int32)
    rasterise(corners, faces, (1.0, 1.0), (0.0, 0.0), 0.5, False, 1, inverse, face, owner)
    used = owner.astype(np.uint8)
    mark_specks(used, mesh.uv)
    return used


def mark_specks(used: UInt8, uv: Float32) -> None:
    """Mark in `used` (H, W) the texels that give their colour to triangles (F, 3, 2) without area. Such
    triangles cover no texel, and unused texels are filled with another colour."""
    height, width = used.shape
    specks = uv[triangle_areas(uv) * width * height < SPECK].astype(np.float64)
    read = np.clip(specks * [width, height] - 0.5, 0.0, [width - 1.0, height - 1.0])
    # A colour is read between the centres of four texels.
    for across in (np.floor, np.ceil):
        for down in (np.floor, np.ceil):
            triangles = np.stack([across(read[..., 0]), down(read[..., 1])], -1).astype(np.int32)
            for triangle in np.unique(triangles, axis=0):
                cv2.fillConvexPoly(used, triangle, 1)


def triangle_areas(uv: Float) -> Float64:
    """Areas (F,) of triangles (F, 3, 2), in units of their coordinates."""
    a, b = (uv[:, 1:] - uv[:, :1]).astype(np.float64).transpose(1, 0, 2)
    return np.asarray(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2.0)


@jit
def _halve(fine: UInt8, used: UInt8, coarse: UInt8, mask: UInt8) -> None:
    height, width = fine.shape[:2]
    for row in range(coarse.shape[0]):
        for column in range(coarse.shape[1]):
            n, red, green, blue = 0, 0, 0, 0
            for y in range(2 * row, min(2 * row + 2, height)):
                for x in range(2 * column, min(2 * column + 2, width)):
                    if used[y, x]:
                        n += 1
                        red += fine[y, x, 0]
                        green += fine[y, x, 1]
                        blue += fine[y, x, 2]
            mask[row, column] = n > 0
            half = n // 2
            n = max(n, 1)
            coarse[row, column, 0] = (red + half) // n
            coarse[row, column, 1] = (green + half) // n
            coarse[row, column, 2] = (blue + half) // n


@jit
def _fill_unused(fine: UInt8, used: UInt8, coarse: UInt8) -> None:
    for row in range(fine.shape[0]):
        y = min(row // 2, coarse.shape[0] - 1)
        for column in range(fine.shape[1]):
            if not used[row, column]:
                x = min(column // 2, coarse.shape[1] - 1)
                fine[row, column] = coarse[y, x]
