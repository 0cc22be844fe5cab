"""What of a camera's picture looks as it did before: an unchanged place gives an unchanged answer.

Pictures are compared in tiles, by means of colour and depth, which have little noise; a tile that holds an
edge may differ by a share of what it holds, since depth and blur flicker there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.geometry.frame import RgbdFrame
from huepose.support.jit import jit

TILE_PX = 8
LEVELS, OF_DEVIATION = 4.0, 0.1
"""A tile has changed whose mean colour differs by so many of 255 levels in a channel, and so much of its
deviation."""

DEPTH_M, DEPTH_PER_M, OF_DEPTH_DEVIATION, WHOLE = 0.006, 0.006, 0.5, 0.9
"""Or whose mean depth does by this, so much more per square metre of depth squared, and so much of its
deviation, where more of its pixels than that have depth: holes come and go at edges."""

UNKNOWN, KNOWN = 0.05, 0.9
"""Or which had depth in less of its pixels than the one and now has in more than the other, or the other way
round."""

_COLORS = 3
_SUMS = 2 * _COLORS + 3


@dataclass(frozen=True, eq=False)
class Tiles:
    """A picture in tiles of TILE_PX: means (h, w, 4) of red, green, blue and of the depth in metres that is
    known; their deviations (h, w, 4); known (h, w): share of pixels with depth."""

    means: Float32
    deviations: Float32
    known: Float32

    @staticmethod
    def of(frame: RgbdFrame) -> Tiles:
        """Those of a frame; what is left of a tile at the right and lower side is left out."""
        height, width = (side // TILE_PX for side in frame.depth.shape)
        sums = np.zeros((height, width, _SUMS), np.float64)
        _add_up(frame.color, frame.depth, sums)
        pixels = float(TILE_PX**2)
        with_depth = np.maximum(sums[..., 8], 1.0)
        means = np.concatenate([sums[..., :3] / pixels, (sums[..., 6] / with_depth)[..., None]], axis=2)
        squares = np.concatenate([sums[..., 3:6] / pixels, (sums[..., 7] / with_depth)[..., None]], axis=2)
        deviations = np.sqrt(np.maximum(squares - means**2, 0.0))
        return Tiles(
            means.astype(np.float32),
            deviations.astype(np.float32),
            (sums[..., 8] / pixels).astype(np.float32),
        )

    def changed(self, before: Tiles) -> Bool:
        """Which tiles (h, w) look otherwise than before."""
        apart = np.abs(self.means - before.means)
        deviations = np.maximum(self.deviations, before.deviations)
        colored = (apart[..., :3] > LEVELS + OF_DEVIATION * deviations[..., :3]).any(2)
        z = np.minimum(self.means[..., 3], before.means[..., 3])
        far = apart[..., 3] > DEPTH_M + DEPTH_PER_M * z**2 + OF_DEPTH_DEVIATION * deviations[..., 3]
        least, most = np.minimum(self.known, before.known), np.maximum(self.known, before.known)
        return np.asarray(colored | (far & (least > WHOLE)) | ((least < UNKNOWN) & (most > KNOWN)))


def changed_shares(changed: Bool, pixels: Float64, span_px: Float64) -> Float64:
    """Share (W,) of the tiles (h, w) that have changed in windows `span_px` (W,) wide, with their middles at
    pixels (W, 2) of the frame; of windows without a whole tile 1."""
    sums = np.zeros((changed.shape[0] + 1, changed.shape[1] + 1), np.int64)
    sums[1:, 1:] = changed.cumsum(0).cumsum(1)
    limits = np.array([changed.shape[1], changed.shape[0]])
    low = np.clip(np.floor((pixels - 0.5 * span_px[:, None]) / TILE_PX), 0, limits).astype(np.int64)
    high = np.clip(np.ceil((pixels + 0.5 * span_px[:, None]) / TILE_PX), 0, limits).astype(np.int64)
    inside = (
        sums[high[:, 1], high[:, 0]]
        - sums[low[:, 1], high[:, 0]]
        - sums[high[:, 1], low[:, 0]]
        + sums[low[:, 1], low[:, 0]]
    )
    count = (high - low).prod(1)
    return np.where(count > 0, inside / np.maximum(count, 1), 1.0)


@jit
def _add_up(color: UInt8, depth: Float32, sums: Float64) -> None:
    """Add to each tile's sums (h, w, 9): colours, their squares, depth, its squares, pixels that have any."""
    for y in range(sums.shape[0]):
        for v in range(TILE_PX * y, TILE_PX * (y + 1)):
            for x in range(sums.shape[1]):
                tile = sums[y, x]
                for u in range(TILE_PX * x, TILE_PX * (x + 1)):
                    for c in range(_COLORS):
                        value = float(color[v, u, c])
                        tile[c] += value
                        tile[_COLORS + c] += value * value
                    z = float(depth[v, u])
                    if z > 0.0:
                        tile[6] += z
                        tile[7] += z * z
                        tile[8] += 1.0
