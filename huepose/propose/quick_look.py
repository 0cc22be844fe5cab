"""The quick look: the first, fast comparison of all view templates with all windows of an image, by sums
over cells.

A window is the image around a pixel, resampled at metric scale to the cells of the templates. Colours are
averaged as linear light, then converted to opponents; depth becomes relief, its difference from a median
depth. The code is compiled, since a frame has dozens of windows.

The score has four terms: correlation of opponent colours (so that the strength of light does not matter),
standard deviation of the relief difference, cells of the mask that the template covers, and cells of the
template where the background is visible. All follow from sums over the cells that a template covers, so
thousands of templates take a few milliseconds.
"""

from __future__ import annotations

import cv2
import numpy as np

from huepose.colorpair.opponents import DARKEST, LINEAR, SCALE
from huepose.geometry.arrays import Float32, Float64, Int64, UInt8
from huepose.propose.templates import AT_ONCE, MILLIMETRES, TemplateTable
from huepose.support.jit import jit_dividing

OVERSAMPLING = 4
"""Most samples averaged per cell and axis."""

MIN_SHARE = 0.3
"""Share of a cell's samples that must be known for the cell to count."""


def sampled(
    color: UInt8, depth: Float32, centre: Float64, cell: float, cells: int
) -> tuple[int, UInt8, Float32, Float64]:
    """Resample colours (H, W, 3) and depth (H, W) on a lattice of `cells` cells a side, each `cell` pixels
    wide, centred on a pixel (2,). Returns samples per cell and axis, colours (n, n, 3), depth (n, n), and
    the affine map (2, 3) from lattice to image."""
    fine = max(1, min(OVERSAMPLING, round(cell)))
    step, n = cell / fine, cells * fine
    to_image = np.array(
        [[step, 0.0, centre[0] - (n - 1) / 2 * step], [0.0, step, centre[1] - (n - 1) / 2 * step]]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    colors = np.asarray(cv2.warpAffine(color, to_image, (n, n), flags=flags), dtype=np.uint8)
    return fine, colors, np.asarray(nearest(depth, to_image, n), dtype=np.float32), to_image


def nearest(image: np.ndarray, to_image: Float64, n: int) -> np.ndarray:
    """Values (n, n) of an image on a lattice, by nearest neighbour."""
    return cv2.warpAffine(image, to_image, (n, n), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)


def masked_cells(
    color: UInt8, depth: Float32, inside: UInt8, fine: int, middle_m: float, behind_m: float
) -> Float32:
    """Cells (c, c, 6) of samples (n, n): three opponents and relief (millimetres) averaged inside a mask, the
    share of samples inside it (0 below MIN_SHARE), and the share outside it that is farther than
    `behind_m`."""
    cells = len(depth) // fine
    out = np.zeros((cells, cells, 6), np.float32)
    _masked(color, depth, inside, fine, middle_m, behind_m, out)
    return out


@jit_dividing
def write_opponents(red: float, green: float, blue: float, out: Float32) -> None:
    """Write the opponents (see `colorpair.opponents`) of linear values into out[:3]."""
    r, g, b = SCALE * np.log(red + DARKEST), SCALE * np.log(green + DARKEST), SCALE * np.log(blue + DARKEST)
    out[0] = (r + g + b) * (1.0 / 3.0)
    out[1] = r - g
    out[2] = 0.5 * (r + g) - b


@jit_dividing
def _masked(
    color: UInt8,
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
                        red += LINEAR[color[v, u, 0]]
                        green += LINEAR[color[v, u, 1]]
                        blue += LINEAR[color[v, u, 2]]
                        total += z - middle_m
                        known += 1.0
                    elif z > behind_m:
                        behind += 1.0
            out[y, x, 5] = behind * each
            if known * each > MIN_SHARE:
                write_opponents(red / known, green / known, blue / known, out[y, x])
                out[y, x, 3] = total / known * MILLIMETRES
                out[y, x, 4] = known * each


RELIEF_SIGMA = 0.05
"""Standard deviation of the relief difference, in diameters, at which the depth term has fallen to 0.6."""

CHANNEL_WEIGHTS = (0.35, 1.0, 1.0)
"""Weights of lightness, red-green and yellow-blue in the correlation."""
CHANNEL_FLOOR = 9.0
"""Added to the product of the standard deviations, squared opponent units: flat cells have no
correlation."""
DEPTH_WEIGHT, OVERLAP_WEIGHT, FREE_WEIGHT, FULL_WEIGHT = 0.8, 1.0, 0.8, 0.3
"""Weights of depth, of the share of the mask that is covered, of the share of the template on background
(subtracted) and on the mask. Chosen."""

LANES = 32
"""Windows that a template is compared with at once."""

SEEN = 10
"""Numbers of a window's cell that are summed. With w the known share of the cell and v its four values: w,
the share of background, w v, w v v."""

SUMS = 22
"""Sums over a template's cells for each window. With c the coverage and t the four values of a template's
cell: of the SEEN numbers times c; of w v times c t; of w times c t; of w times c t t."""


def quick_look(table: TemplateTable, windows: Float32, places: int) -> tuple[Int64, Float32]:
    """For each of M groups of `places` windows and each of N templates: index (M, N) of the best window in
    the group and its score (M, N). windows: (M * places, cells, 6) as of `masked_cells`."""
    count, blocks = len(windows), -(-len(windows) // LANES)
    which = np.zeros((count // places, len(table.area)), np.int64)
    scores = np.zeros(which.shape, np.float32)
    seen, sums = _in_line(blocks * len(table.used) * SEEN * LANES), _in_line(SUMS * LANES)
    area = np.ones(blocks * LANES, np.float32)
    _lay_out(windows, table.used, seen, area)
    relief_mm = RELIEF_SIGMA * table.diameter_m * MILLIMETRES
    _score_windows(
        table.begins, table.cells, table.numbers.reshape(-1), table.area, seen, area, count, places,
        relief_mm, sums, which, scores,
    )  # fmt: skip
    return which, scores


def _in_line(count: int) -> Float32:
    """`count` zeros that start at a cache line: vectors across two lines cost twice."""
    numbers = np.zeros(count + 15, np.float32)
    first = -(numbers.ctypes.data // 4) % 16
    return numbers[first : first + count]


@jit_dividing
def _lay_out(windows: Float32, used: Int64, seen: Float32, area: Float32) -> None:
    """Fill `seen` with the numbers of the cells `used` (P,) of windows (C, Q, 6), flat: (blocks of windows,
    P, SEEN, LANES). Fill `area` (C or more,) with how much of each window is known. In a cell, number 4 is
    w, number 5 the background, and numbers 0 to 3 are v: the three opponents and relief."""
    for k in range(windows.shape[0]):
        known = np.float32(0.0)
        for p in range(used.shape[0]):
            cell = windows[k, used[p]]
            at = (k // LANES * used.shape[0] + p) * SEEN * LANES + k % LANES
            w = cell[4]
            known += w
            seen[at], seen[at + LANES] = w, cell[5]
            for c in range(4):
                weighted = w * cell[c]
                seen[at + (2 + c) * LANES] = weighted
                seen[at + (6 + c) * LANES] = weighted * cell[c]
        area[k] = max(known, np.float32(1.0))


@jit_dividing
def _score_windows(
    begins: Int64,
    cells: UInt8,
    numbers: Float32,
    template_area: Float32,
    seen: Float32,
    window_area: Float32,
    count: int,
    places: int,
    relief_mm: float,
    sums: Float32,
    which: Int64,
    scores: Float32,
) -> None:
    """Fill `which` and `scores` (M, N): best window of each group for each template."""
    blocks = window_area.shape[0] // LANES
    size = seen.shape[0] // blocks
    without_depth, deviation = np.empty_like(window_area), np.empty_like(window_area)
    sharpness = 1.0 / (2.0 * relief_mm * relief_mm)
    for i in range(template_area.shape[0]):
        for block in range(blocks):
            k = block * LANES
            lanes = min((count - k + 15) // 16 * 16, LANES)  # a whole vector, or two
            _sum_up(begins[i], begins[i + 1], cells, numbers, seen, block * size, lanes, sums)
            _rate(sums, lanes, template_area[i], window_area[k:], without_depth[k:], deviation[k:])
        for g in range(which.shape[0]):
            best = -1e9
            for k in range(places):
                now, apart = without_depth[g * places + k], deviation[g * places + k] * sharpness
                if (now - best) * (1.0 + apart * (1.0 + 0.5 * apart)) <= -DEPTH_WEIGHT:
                    continue  # exp(-x) <= 1 / (1 + x + x * x / 2): not even that would help.
                total = now + DEPTH_WEIGHT * np.exp(-apart)
                if total > best:
                    best = total
                    which[g, i] = k
            scores[g, i] = best


@jit_dividing
def _sum_up(
    begin: int, end: int, cells: UInt8, numbers: Float32, seen: Float32, block: int, lanes: int, sums: Float32
) -> None:
    """Fill `sums` (SUMS * LANES,) for the cells `begin` to `end` of a template, AT_ONCE together, and the
    windows of the block that begins at `block`. Indices are unsigned and rows a constant apart, so that the
    compiler vectorises the loops."""
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    cell, row, number, wide = np.uint64(SEEN * LANES), np.uint64(LANES), np.uint64(5), np.uint64(lanes)
    for p in range(np.uint64(SUMS * LANES)):
        sums[p] = np.float32(0.0)
    for n in range(np.uint64(begin), np.uint64(end), np.uint64(AT_ONCE)):
        x, y = np.uint64(block) + cells[n] * cell, np.uint64(block) + cells[n + one] * cell
        z, t = np.uint64(block) + cells[n + two] * cell, np.uint64(block) + cells[n + three] * cell
        i, j = n * number, (n + one) * number
        k, m = (n + two) * number, (n + three) * number
        a, b, c, d = numbers[i], numbers[j], numbers[k], numbers[m]
        for p in range(cell):
            sums[p] += a * seen[x + p] + b * seen[y + p] + c * seen[z + p] + d * seen[t + p]
        for q in range(one, number):
            e, f, g, h = numbers[i + q], numbers[j + q], numbers[k + q], numbers[m + q]
            a1, b1, c1, d1 = a * e, b * f, c * g, d * h
            a2, b2, c2, d2 = a1 * e, b1 * f, c1 * g, d1 * h
            value, crossed = (q + one) * row, (q + np.uint64(9)) * row
            first, second = (q + np.uint64(13)) * row, (q + np.uint64(17)) * row
            for p in range(wide):
                at = value + p
                sums[crossed + p] += (
                    a1 * seen[x + at] + b1 * seen[y + at] + c1 * seen[z + at] + d1 * seen[t + at]
                )
                u, v, w, s = seen[x + p], seen[y + p], seen[z + p], seen[t + p]
                sums[first + p] += a1 * u + b1 * v + c1 * w + d1 * s
                sums[second + p] += a2 * u + b2 * v + c2 * w + d2 * s


@jit_dividing
def _rate(
    sums: Float32, lanes: int, area: float, window_area: Float32, without_depth: Float32, deviation: Float32
) -> None:
    """Fill the score `without_depth` and the `deviation` of the relief, square millimetres, of each window
    from the sums over a template's cells."""
    one, zero, floor = np.float32(1.0), np.float32(0.0), np.float32(CHANNEL_FLOOR)
    covered = np.float32(max(area, 1.0))
    free, full = np.float32(FREE_WEIGHT) / covered, np.float32(FULL_WEIGHT) / covered
    of_values, of_squares, crossed = np.uint64(2 * LANES), np.uint64(6 * LANES), np.uint64(10 * LANES)
    template_values, template_squares = np.uint64(14 * LANES), np.uint64(18 * LANES)
    for k in range(np.uint64(lanes)):
        shared = sums[k]
        common = one / max(shared, one)
        color, weights = zero, np.float32(2.0)
        for c in range(np.uint64(3)):
            at = c * np.uint64(LANES) + k
            mean_w, mean_t = sums[at + of_values] * common, sums[at + template_values] * common
            var_w = max(sums[at + of_squares] * common - mean_w * mean_w, zero)
            var_t = max(sums[at + template_squares] * common - mean_t * mean_t, zero)
            w = np.float32(CHANNEL_WEIGHTS[c]) * np.sqrt(var_t)
            both = sums[at + crossed] * common - mean_w * mean_t
            color += w * both / (np.sqrt(var_w * var_t) + floor)
            weights += w
        at = np.uint64(3 * LANES) + k  # relief
        apart = (sums[at + of_values] - sums[at + template_values]) * common
        both = sums[at + crossed]
        square = (sums[at + of_squares] + sums[at + template_squares] - both - both) * common
        deviation[k] = max(square - apart * apart, zero)
        without_depth[k] = (
            color / weights
            + np.float32(OVERLAP_WEIGHT) * shared / window_area[k]
            - free * sums[k + np.uint64(LANES)]
            + full * shared
        )
