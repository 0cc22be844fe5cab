"""A picture in the cells that templates have: resampled about a pixel, at metric scale, and averaged.

Colours are averaged as linear light and described as opponents afterwards; depth is the relief about a middle
depth. Compiled, since a frame has dozens of such small pictures and each is a dozen steps.
"""

from __future__ import annotations

import cv2
import numpy as np

from huepose.colorpair.opponents import DARKEST, LINEAR, SCALE
from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.propose.template_table import MILLIMETRES
from huepose.support.jit import jit_dividing

OVERSAMPLING = 4
"""At most so many samples a cell and axis are averaged."""

MIN_SHARE = 0.3
"""A cell of which less is known counts as unknown."""


def sampled(
    color: UInt8, depth: Float32, centre: Float64, cell: float, cells: int
) -> tuple[int, UInt8, Float32, Float64]:
    """Colours and depth on a fine lattice of `cells` cells a side, each `cell` pixels wide, about a pixel:
    samples a cell and axis, (n, n, 3), (n, n), and the map (2, 3) from the lattice to the picture."""
    fine = max(1, min(OVERSAMPLING, round(cell)))
    step, n = cell / fine, cells * fine
    to_picture = np.array(
        [[step, 0.0, centre[0] - (n - 1) / 2 * step], [0.0, step, centre[1] - (n - 1) / 2 * step]]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    colors = np.asarray(cv2.warpAffine(color, to_picture, (n, n), flags=flags), dtype=np.uint8)
    return fine, colors, np.asarray(nearest(depth, to_picture, n), dtype=np.float32), to_picture


def nearest(image: np.ndarray, to_picture: Float64, n: int) -> np.ndarray:
    """Values (n, n) of an image at the nearest pixels of a lattice."""
    return cv2.warpAffine(image, to_picture, (n, n), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)


def masked_cells(
    color: UInt8, depth: Float32, inside: UInt8, fine: int, middle_m: float, behind_m: float
) -> Float32:
    """Cells (c, c, 6) of samples (n, n): opponents and relief in millimetres of what is inside a mask, the
    share that is (0 under MIN_SHARE), and the share outside of it that lies beyond the depth `behind_m`."""
    cells = len(depth) // fine
    out = np.zeros((cells, cells, 6), np.float32)
    _masked(color, LINEAR, depth, inside, fine, middle_m, behind_m, out)
    return out


def known_cells(color: UInt8, depth: Float32, fine: int, middle_m: float) -> tuple[Float32, Float32, Bool]:
    """Opponents (c, c, 3) and relief (c, c) in millimetres of all samples (n, n) with depth, and which cells
    (c, c) have them. Relief is one reading in the middle of a cell: means across a depth step would lie on no
    surface."""
    cells = len(depth) // fine
    colors, relief = np.zeros((cells, cells, 3), np.float32), np.zeros((cells, cells), np.float32)
    valid = np.zeros((cells, cells), bool)
    smooth = np.asarray(cv2.medianBlur(depth, 3), dtype=np.float32)
    _known(color, LINEAR, depth, smooth, fine, middle_m, colors, relief, valid)
    return colors, relief, valid


@jit_dividing
def _describe(red: float, green: float, blue: float, out: Float32) -> None:
    """Opponents, as in `colorpair.opponents`, of linear values into out[:3]."""
    r, g, b = SCALE * np.log(red + DARKEST), SCALE * np.log(green + DARKEST), SCALE * np.log(blue + DARKEST)
    out[0] = (r + g + b) * (1.0 / 3.0)
    out[1] = r - g
    out[2] = 0.5 * (r + g) - b


@jit_dividing
def _masked(
    color: UInt8,
    linear: Float32,
    depth: Float32,
    inside: UInt8,
    fine: int,
    middle_m: float,
    behind_m: float,
    out: Float32,
) -> None:
    each = 1.0 / (fine * fine)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            red, green, blue, total, known, behind = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for v in range(y * fine, (y + 1) * fine):
                for u in range(x * fine, (x + 1) * fine):
                    z = depth[v, u]
                    if inside[v, u] and z > 0.0:
                        red += linear[color[v, u, 0]]
                        green += linear[color[v, u, 1]]
                        blue += linear[color[v, u, 2]]
                        total += z - middle_m
                        known += 1.0
                    elif z > behind_m:
                        behind += 1.0
            out[y, x, 5] = behind * each
            if known * each > MIN_SHARE:
                _describe(red / known, green / known, blue / known, out[y, x])
                out[y, x, 3] = total / known * MILLIMETRES
                out[y, x, 4] = known * each


@jit_dividing
def _known(
    color: UInt8,
    linear: Float32,
    depth: Float32,
    smooth: Float32,
    fine: int,
    middle_m: float,
    colors: Float32,
    relief: Float32,
    valid: Bool,
) -> None:
    for y in range(relief.shape[0]):
        for x in range(relief.shape[1]):
            red, green, blue, known = 0.0, 0.0, 0.0, 0.0
            for v in range(y * fine, (y + 1) * fine):
                for u in range(x * fine, (x + 1) * fine):
                    if depth[v, u] > 0.0:
                        red += linear[color[v, u, 0]]
                        green += linear[color[v, u, 1]]
                        blue += linear[color[v, u, 2]]
                        known += 1.0
            z = smooth[y * fine + fine // 2, x * fine + fine // 2]
            if z > 0.0 and known > MIN_SHARE * fine * fine:
                valid[y, x] = True
                relief[y, x] = (z - middle_m) * MILLIMETRES
                _describe(red / known, green / known, blue / known, colors[y, x])
