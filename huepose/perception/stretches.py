"""Connected pieces of a mask as stretches: runs of pixels in a row. There are far fewer of them than
pixels, so sums over pieces are fast. Run-based labelling: He, Chao and Suzuki, A Run-Based Two-Scan
Labeling Algorithm (IEEE TIP 2008)."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Int, Int32, UInt8
from huepose.support.jit import jit


@jit
def connected(mask: UInt8) -> tuple[Int32, int]:
    """The stretches (N, 4) of a mask (H, W), row by row: row, first column, column after the last, and
    piece; and how many pieces there are. Pieces are connected by 4 neighbours, and numbered from 0 in the
    order of their first pixels."""
    height, width = mask.shape
    found = np.empty((height * ((width + 1) // 2), 4), np.int32)
    piece = found[:, 3]
    n = above = 0
    for v in range(height):
        here, u = n, 0
        while u < width:
            if not mask[v, u]:
                u += 1
                continue
            first = u
            while u < width and mask[v, u]:
                u += 1
            found[n, 0], found[n, 1], found[n, 2], found[n, 3] = v, first, u, n
            while above < here and found[above, 2] <= first:
                above += 1
            k = above
            while k < here and found[k, 1] < u:
                i, j = _root(piece, k), _root(piece, n)
                piece[max(i, j)] = min(i, j)
                k += 1
            n += 1
        above = here
    count = 0
    for k in range(n):
        if piece[k] == k:
            piece[k] = count
            count += 1
        else:
            piece[k] = piece[piece[k]]  # its root is already numbered: a root comes before its stretches
    return found[:n], count


@jit
def _root(piece: Int32, k: int) -> int:
    while piece[k] != k:
        piece[k] = piece[piece[k]]
        k = piece[k]
    return k


@jit
def write_values(stretches: Int32, values: Int, out: Int) -> None:
    """Write to each pixel (H, W) of some stretches the value (P,) of its piece."""
    for v, first, last, piece in stretches:
        out[v, first:last] = values[piece]
