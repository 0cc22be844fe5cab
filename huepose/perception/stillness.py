"""Detects which parts of a camera's image have changed.

Images are compared in tiles by mean colour and mean depth, which have little noise. The threshold grows
with a tile's standard deviation, because depth and blur flicker at edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.geometry.frame import RgbdFrame
from huepose.support.jit import jit

TILE_PX = 8
"""Side of a tile, pixels."""

LEVELS, OF_DEVIATION = 4.0, 0.1
"""A tile has changed if the mean of a colour channel differs by more than LEVELS (of 255) plus this share of
its standard deviation."""

DEPTH_M, DEPTH_PER_M, OF_DEPTH_DEVIATION, WHOLE = 0.006, 0.006, 0.5, 0.9
"""Or if its mean depth differs by more than DEPTH_M + DEPTH_PER_M * z^2 (stereo noise) plus this share of
its standard deviation. Only tiles with depth in more than WHOLE of their pixels are compared: holes flicker
at edges."""

UNKNOWN, KNOWN = 0.05, 0.9
"""Or if its share of pixels with depth went from below UNKNOWN to above KNOWN, or back."""

_COLORS = 3
_SUMS = 2 * _COLORS + 3


@dataclass(frozen=True, eq=False)
class Tiles:
    """An image in tiles of TILE_PX pixels. means (h, w, 4): red, green, blue, and known depth in metres;
    deviations (h, w, 4): their standard deviations; known (h, w): share of pixels with depth."""

    means: Float32
    deviations: Float32
    known: Float32

    @staticmethod
    def of(frame: RgbdFrame) -> Tiles:
        """The tiles of a frame; incomplete ones at the right and bottom are left out."""
        height, width = (side // TILE_PX for side in frame.depth.shape)
        sums = np.zeros((height, width, _SUMS), np.float64)
        # Read-only, as images come from the wire: for a writable array the kernel would be compiled once
        # more.
        color = frame.color.view()
        color.flags.writeable = False
        _add_up(color, frame.depth, sums)
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
        """Mask (h, w) of the tiles that differ from `before`."""
        apart = np.abs(self.means - before.means)
        deviations = np.maximum(self.deviations, before.deviations)
        colored = (apart[..., :3] > LEVELS + OF_DEVIATION * deviations[..., :3]).any(2)
        z = np.minimum(self.means[..., 3], before.means[..., 3])
        far = apart[..., 3] > DEPTH_M + DEPTH_PER_M * z**2 + OF_DEPTH_DEVIATION * deviations[..., 3]
        least, most = np.minimum(self.known, before.known), np.maximum(self.known, before.known)
        return np.asarray(colored | (far & (least > WHOLE)) | ((least < UNKNOWN) & (most > KNOWN)))


def changed_shares(changed: Bool, pixels: Float64, span_px: Float64) -> Float64:
    """Share (W,) of changed tiles in windows of side span_px (W,) centred at pixels (W, 2) of the frame; 1
    for a window that covers no tile. changed: mask (h, w)."""
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
    """Accumulate in each tile's sums (h, w, 9): colours, their squares, depth, its square, pixels with
    depth."""
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
