"""From colour pairs in an image to colour pairs on a surface: position, normal, and the way across the
edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.colorpair.types import ColorPairs
from huepose.geometry.arrays import Bool, Float, Float32, Int
from huepose.geometry.camera import Camera


@dataclass(frozen=True, eq=False)
class SurfacePairs:
    """N colour pairs on a surface: points, normals, tangents (N, 3) float32, the tangent being the unit
    direction in the surface from side 0 to side 1; colors (N, 2, 3) float32 CIELAB; widths (N,) float32
    pixels."""

    points: Float32
    normals: Float32
    tangents: Float32
    colors: Float32
    widths: Float32

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, index: Int | Bool | slice) -> SurfacePairs:
        return SurfacePairs(
            self.points[index],
            self.normals[index],
            self.tangents[index],
            self.colors[index],
            self.widths[index],
        )


def lift(
    pairs: ColorPairs, points: Float32, normals: Float32, camera: Camera, min_facing: float = 0.25
) -> tuple[SurfacePairs, Bool]:
    """Pairs of a camera image on the surface that it sees; also which of the pairs (N,) were kept.

    points, normals (H, W, 3) in camera axes, normals towards the camera, 0 where nothing is known. Dropped
    are pairs without a surface, seen at a cosine under `min_facing`, or with a jump between their sides.
    The tangent is the image direction projected along the viewing ray onto the tangent plane, so it does not
    depend on noise in the depth of single pixels.
    """
    height, width = points.shape[:2]
    way = np.stack([np.cos(pairs.directions), np.sin(pairs.directions)], 1)
    middle, known = _read(points, pairs.pixels, height, width)
    normal, has_normal = _read(normals, pairs.pixels, height, width)
    reach = np.clip(pairs.widths, 2.0, 6.0)[:, None] * way
    side_0, known_0 = _read(points, pairs.pixels - reach, height, width)
    side_1, known_1 = _read(points, pairs.pixels + reach, height, width)
    rays = camera.rays(pairs.pixels)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    facing = -(rays * normal).sum(1)
    ahead = camera.rays(pairs.pixels + 0.5 * way) - camera.rays(pairs.pixels - 0.5 * way)
    # slide the image direction along the ray until it lies in the tangent plane
    along = (ahead * normal).sum(1) / np.minimum(-facing, -1e-3)
    tangent = ahead - along[:, None] * rays
    step = np.linalg.norm(tangent, axis=1) * middle[:, 2]
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    span = 2.0 * np.linalg.norm(reach, axis=1) * step
    gap = np.linalg.norm(side_1 - side_0, axis=1)
    kept = known & has_normal & known_0 & known_1 & (facing > min_facing) & (gap < 3.0 * span + 0.002)
    # the point lies on the ray of the sub-pixel position
    exact = camera.rays(pairs.pixels) * middle[:, 2:3]
    lifted = SurfacePairs(
        exact[kept].astype(np.float32),
        normal[kept].astype(np.float32),
        tangent[kept].astype(np.float32),
        pairs.colors[kept],
        pairs.widths[kept],
    )
    return lifted, kept


def _read(image: Float32, pixels: Float, height: int, width: int) -> tuple[Float32, Bool]:
    u = np.clip(np.rint(pixels[:, 0]).astype(np.int64), 0, width - 1)
    v = np.clip(np.rint(pixels[:, 1]).astype(np.int64), 0, height - 1)
    values = image[v, u].astype(np.float64)
    inside = (np.abs(pixels[:, 0] - u) < 1) & (np.abs(pixels[:, 1] - v) < 1)
    return values, inside & (np.abs(values).sum(1) > 0)
