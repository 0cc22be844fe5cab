"""The colour pair: the two colours on both sides of a texture edge (paper, section III-A, III-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int


@dataclass(frozen=True, eq=False)
class ColorPairs:
    """N colour pairs of one image.

    pixels (N, 2) float32: sub-pixel position of the ridge point (u, v); directions (N,) float32 radians:
    angle of the image direction that crosses the edge from side 0 to side 1; widths (N,) float32: edge
    thickness in pixels; colors (N, 2, 3) float32: CIELAB (L 0..100) of side 0 and side 1.
    """

    pixels: Float32
    directions: Float32
    widths: Float32
    colors: Float32

    def __len__(self) -> int:
        return len(self.pixels)

    def __getitem__(self, index: Int | Bool | slice) -> ColorPairs:
        return ColorPairs(self.pixels[index], self.directions[index], self.widths[index], self.colors[index])

    @staticmethod
    def empty() -> ColorPairs:
        """No pairs."""
        z = np.zeros
        return ColorPairs(z((0, 2), np.float32), z(0, np.float32), z(0, np.float32), z((0, 2, 3), np.float32))


@dataclass(frozen=True, eq=False)
class SurfacePairs:
    """N colour pairs on a surface, in the frame of a camera or of an object.

    points, normals, tangents (N, 3) float32: the tangent is the unit direction in the surface that crosses
    the edge from side 0 to side 1; colors (N, 2, 3) float32 CIELAB.
    """

    points: Float32
    normals: Float32
    tangents: Float32
    colors: Float32

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, index: Int | Bool | slice) -> SurfacePairs:
        return SurfacePairs(self.points[index], self.normals[index], self.tangents[index], self.colors[index])

    def transformed(self, T_a_b: Float64) -> SurfacePairs:
        """The pairs in frame a, given in frame b, by a rigid transform (4, 4)."""
        R, t = T_a_b[:3, :3].T, T_a_b[:3, 3]
        return SurfacePairs(
            (self.points @ R + t).astype(np.float32),
            (self.normals @ R).astype(np.float32),
            (self.tangents @ R).astype(np.float32),
            self.colors,
        )

    @staticmethod
    def empty() -> SurfacePairs:
        """No pairs."""
        z, f = np.zeros, np.float32
        return SurfacePairs(z((0, 3), f), z((0, 3), f), z((0, 3), f), z((0, 2, 3), f))

    @staticmethod
    def joined(parts: Sequence[SurfacePairs]) -> SurfacePairs:
        """All pairs of one or more sets."""
        names = ("points", "normals", "tangents", "colors")
        return SurfacePairs(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))
