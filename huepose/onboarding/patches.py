"""Patch layouts: a square of texels for every triangle, to bake colours into a texture.

The sides of patches are powers of two. Patches are placed along a Morton curve, in the order of another
Morton curve along the surface. So neighbours on the surface are neighbours in the texture, and its coarser
levels average texels that belong together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64, Int, Int64, UInt8

LARGEST = 1024  # texels a side of a texture
_LARGEST_EQUAL_PATCH, _LARGEST_PATCH = 8, 512  # texels a side: in a layout of equal patches, in any layout

# From faces (N,) and barycentric weights (N, 3) to the colours (N, 3), 0..255, at those points.
Colors = Callable[[Int64, Float64], Float]


@dataclass(frozen=True, eq=False)
class PatchLayout:
    """corners (F, 2): left column and top row of each face's patch; sides (F,): of the patches, in texels;
    size: side of the square texture, in texels."""

    corners: Int64
    sides: Int64
    size: int

    @property
    def uv(self) -> Float32:
        """Texture coordinates (F, 3, 2). Corners are at texel centres, so bilinear lookup stays inside."""
        last = self.sides - 1
        none = np.zeros_like(last)
        offsets = np.stack([np.stack(c, -1) for c in ((none, none), (last, none), (none, last))], 1)
        return ((self.corners[:, None] + offsets + 0.5) / self.size).astype(np.float32)

    def baked(self, colors: Colors) -> UInt8:
        """Bake a texture (size, size, 3) uint8: each patch is filled with the colours of its face."""
        texture = np.zeros((self.size, self.size, 3), np.uint8)
        for side in np.unique(self.sides).tolist():
            faces = np.flatnonzero(self.sides == side)
            last = side - 1
            for y in range(side):
                # Bilinear lookup inside the triangle ends one texel past its edge.
                x = np.tile(np.arange(min(side, last + 2 - y)), len(faces))
                owner = np.repeat(faces, len(x) // len(faces))
                s, t = (x / last, np.full(len(x), y / last)) if last else (np.full(len(x), 1 / 3),) * 2
                values = colors(owner, np.stack([1.0 - s - t, s, t], 1))
                row, column = self.corners[owner, 1] + y, self.corners[owner, 0] + x
                texture[row, column] = np.clip(np.round(values), 0, 255).astype(np.uint8)
        return texture


def equal_patches(vertices: Float, faces: Int) -> PatchLayout | None:
    """Patches of one size, for colours that vary linearly over each face; None for too many faces."""
    grid = 1 << max(0, int(np.ceil(np.log2(len(faces)) / 2)))
    if grid > LARGEST:
        return None
    side = min(_LARGEST_EQUAL_PATCH, LARGEST // grid)
    return _packed(vertices, faces, np.full(len(faces), side, np.int64))


def fitting_patches(vertices: Float, faces: Int) -> PatchLayout:
    """Patches of sizes like their faces, at the finest scale at which all fit; for up to 250,000 faces."""
    v = np.asarray(vertices, np.float64)[faces]
    longest = np.linalg.norm(v - np.roll(v, 1, axis=1), axis=2).max(1)
    low, high = longest.max() / LARGEST / 64, longest.max()
    for _ in range(40):
        texel = np.sqrt(low * high)
        fits = (_sides(longest, texel) ** 2).sum() <= LARGEST**2
        low, high = (low, texel) if fits else (texel, high)
    return _packed(vertices, faces, _sides(longest, high))


def _sides(longest: Float64, texel: float) -> Int64:
    powers = np.ceil(np.log2(longest / texel + 2))
    return np.asarray(np.clip(2.0**powers, 2, _LARGEST_PATCH), np.int64)


def _packed(vertices: Float, faces: Int, sides: Int64) -> PatchLayout:
    """Patches along a Morton curve of texels, largest first: each begins at a multiple of its own area."""
    along = _along_surface(np.asarray(vertices, np.float64), faces)
    order = along[np.argsort(-sides[along], kind="stable")]
    areas = sides[order] ** 2
    starts = np.cumsum(areas) - areas
    corners = np.empty((len(faces), 2), np.int64)
    corners[order] = np.stack([_every_other_bit(starts), _every_other_bit(starts >> 1)], 1)
    size = 1 << int(np.ceil(np.log2(areas.sum()) / 2))
    return PatchLayout(corners, sides, size)


def _along_surface(vertices: Float64, faces: Int) -> Int64:
    """Order of the faces along a Morton curve of their centres; faces with similar normals are together."""
    corners = vertices[faces]
    centres = corners.mean(1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    low = centres.min(0)
    cells = ((centres - low) / (np.ptp(centres, axis=0).max() + 1e-30) * 1023).astype(np.int64)
    key = np.zeros(len(faces), np.int64)
    for axis in range(3):
        for bit in range(10):
            key |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
        key |= (normals[:, axis] > 0).astype(np.int64) << (30 + axis)
    return np.asarray(np.argsort(key, kind="stable"), np.int64)


def _every_other_bit(number: Int64) -> Int64:
    out = np.zeros_like(number)
    for bit in range(16):
        out |= ((number >> (2 * bit)) & 1) << bit
    return out
