"""The quick look: score all view templates against all windows of a picture, by matrix products.

A window is the picture around a pixel, resampled at metric scale to the cells of the templates. Colours are
averaged as linear light, then converted to opponents; depth becomes relief, its difference from a median
depth. Compiled, since a frame has dozens of windows.

The score has four terms: correlation of opponent colours (so that the strength of light does not matter),
standard deviation of the relief difference, cells of the mask that the template covers, and cells of the
template where the background is seen. All are sums over cells, so thousands of templates take a few
milliseconds.
"""

from __future__ import annotations

import cv2
import numpy as np

from huepose.colorpair.opponents import DARKEST, LINEAR, SCALE
from huepose.geometry.arrays import Bool, Float32, Float64, Int64, UInt8
from huepose.propose.templates import MILLIMETRES, TemplateTable
from huepose.support.jit import jit_dividing

OVERSAMPLING = 4
"""Most samples averaged per cell and axis."""

MIN_SHARE = 0.3
"""Share of a cell's samples that must be known for the cell to count."""


def sampled(
    color: UInt8, depth: Float32, centre: Float64, cell: float, cells: int
) -> tuple[int, UInt8, Float32, Float64]:
    """Resample colours (H, W, 3) and depth (H, W) on a lattice of `cells` cells a side, each `cell` pixels
    wide, centred on a pixel (2,). Returns samples per cell and axis, colours (n, n, 3), depth (n, n), and the
    affine map (2, 3) from lattice to picture."""
    fine = max(1, min(OVERSAMPLING, round(cell)))
    step, n = cell / fine, cells * fine
    to_picture = np.array(
        [[step, 0.0, centre[0] - (n - 1) / 2 * step], [0.0, step, centre[1] - (n - 1) / 2 * step]]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    colors = np.asarray(cv2.warpAffine(color, to_picture, (n, n), flags=flags), dtype=np.uint8)
    return fine, colors, np.asarray(nearest(depth, to_picture, n), dtype=np.float32), to_picture


def nearest(image: np.ndarray, to_picture: Float64, n: int) -> np.ndarray:
    """Values (n, n) of an image on a lattice, by nearest neighbour."""
    return cv2.warpAffine(image, to_picture, (n, n), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)


def masked_cells(
    color: UInt8, depth: Float32, inside: UInt8, fine: int, middle_m: float, behind_m: float
) -> Float32:
    """Cells (c, c, 6) of samples (n, n): three opponents and relief (millimetres) averaged inside a mask, the
    share of samples inside it (0 below MIN_SHARE), and the share outside it that is farther than
    `behind_m`."""
    cells = len(depth) // fine
    out = np.zeros((cells, cells, 6), np.float32)
    _masked(color, LINEAR, depth, inside, fine, middle_m, behind_m, out)
    return out


def known_cells(color: UInt8, depth: Float32, fine: int, middle_m: float) -> tuple[Float32, Float32, Bool]:
    """Opponents (c, c, 3), relief (c, c) in millimetres and validity (c, c) of all samples (n, n) with depth.
    Relief is the one reading in the middle of a cell: a mean across a depth step would lie on no surface."""
    cells = len(depth) // fine
    colors, relief = np.zeros((cells, cells, 3), np.float32), np.zeros((cells, cells), np.float32)
    valid = np.zeros((cells, cells), bool)
    smooth = np.asarray(cv2.medianBlur(depth, 3), dtype=np.float32)
    _known(color, LINEAR, depth, smooth, fine, middle_m, colors, relief, valid)
    return colors, relief, valid


@jit_dividing
def _opponents(red: float, green: float, blue: float, out: Float32) -> None:
    """Write the opponents (see `colorpair.opponents`) of linear values into out[:3]."""
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
                _opponents(red / known, green / known, blue / known, out[y, x])
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
                _opponents(red / known, green / known, blue / known, colors[y, x])


RELIEF_SIGMA = 0.05
"""Standard deviation of the relief difference, in diameters, at which the depth term has fallen to 0.6."""

CHANNEL_WEIGHTS = (0.35, 1.0, 1.0)
"""Of lightness, red-green and yellow-blue in the correlation."""
CHANNEL_FLOOR = 9.0
"""Added to the variances, squared opponent units: flat cells have no correlation."""
DEPTH_WEIGHT, OVERLAP_WEIGHT, FREE_WEIGHT, FULL_WEIGHT = 0.8, 1.0, 0.8, 0.3
"""Of depth, share of the mask covered, share of the template on background (subtracted) and on the mask.
Chosen."""

_NOTHING = np.empty(0, np.float32)
"""In place of what OpenCV would add to a product."""


def quick_look(table: TemplateTable, windows: Float32, places: int) -> tuple[Int64, Float32]:
    """For each of M groups of `places` windows and each of N templates: index (M, N) of the best window in
    the group and its score (M, N). windows: (M * places, cells, 6) as of `masked_cells`."""
    count = len(windows)
    by_coverage, crossed, weight = _right_hand_sides(windows, table.used)
    groups = count // places
    which = np.zeros((groups, len(table.area)), np.int64)
    scores = np.zeros((groups, len(table.area)), np.float32)
    area = np.maximum(windows[:, table.used, 4].sum(1), np.float32(1))
    relief_mm = RELIEF_SIGMA * table.diameter_m * MILLIMETRES
    by_value = np.empty((4, len(table.area), 2 * count), np.float32)
    by_square = np.empty((4, len(table.area), count), np.float32)
    for c in range(4):
        product(table.first[c], crossed[c], by_value[c])
        product(table.second[c], weight, by_square[c])
    _score_windows(
        product(table.coverage, by_coverage),
        by_value,
        by_square,
        table.area,
        area,
        places,
        relief_mm,
        which,
        scores,
    )
    return which, scores


@jit_dividing
def _right_hand_sides(windows: Float32, used: Int64) -> tuple[Float32, Float32, Float32]:
    """Right-hand sides of the products, for the cells `used` (P,) of windows (C, Q, 6), in blocks of C
    columns. by_coverage (P, 10 C): w, background, w times each of the four values v, w times their squares;
    crossed (4, P, 2 C): w, w times v, for each value; weights (P, C): w. Of a cell, w is number 4, background
    number 5, v are numbers 0 to 3: the three opponents and relief."""
    count, cells = windows.shape[0], used.shape[0]
    by_coverage = np.empty((cells, 10 * count), np.float32)
    crossed = np.empty((4, cells, 2 * count), np.float32)
    weights = np.empty((cells, count), np.float32)
    for p in range(cells):
        for k in range(count):
            cell = windows[k, used[p]]
            w = cell[4]
            weights[p, k] = by_coverage[p, k] = w
            by_coverage[p, count + k] = cell[5]
            for c in range(4):
                weighted = w * cell[c]
                by_coverage[p, (2 + c) * count + k] = weighted
                by_coverage[p, (6 + c) * count + k] = weighted * cell[c]
                crossed[c, p, k] = w
                crossed[c, p, count + k] = weighted
    return by_coverage, crossed, weights


def product(table: Float32, columns: Float32, out: Float32 | None = None) -> Float32:
    """The matrix product (N, C), into `out` where it is given. By OpenCV: NumPy's linear algebra library
    calls threads for a product of this size, which cost several times what they give."""
    found = cv2.gemm(table, np.ascontiguousarray(columns), 1.0, _NOTHING, 0.0, dst=out)
    return np.asarray(found, np.float32)


@jit_dividing
def _score_windows(
    by_coverage: Float32,
    crossed: Float32,
    squared: Float32,
    template_area: Float32,
    window_area: Float32,
    places: int,
    relief_mm: float,
    which: Int64,
    scores: Float32,
) -> None:
    """Fill `which` and `scores` (M, N): best window of each group for each template, from the matrix
    products."""
    count = window_area.shape[0]
    common, color, weights = (
        np.empty(count, np.float32),
        np.empty(count, np.float32),
        np.empty(count, np.float32),
    )
    without_depth, deviation = np.empty(count, np.float32), np.empty(count, np.float32)
    one, zero, floor = np.float32(1.0), np.float32(0.0), np.float32(CHANNEL_FLOOR)
    sharpness = 1.0 / (2.0 * relief_mm * relief_mm)
    for i in range(template_area.shape[0]):
        free = np.float32(FREE_WEIGHT) / max(template_area[i], one)
        full = np.float32(FULL_WEIGHT) / max(template_area[i], one)
        sums = by_coverage[i]
        for k in range(count):
            common[k] = one / max(sums[k], one)
            color[k] = zero
            weights[k] = np.float32(2.0)
        for c in range(3):
            channel = np.float32(CHANNEL_WEIGHTS[c])
            mean, square = sums[(2 + c) * count : (3 + c) * count], sums[(6 + c) * count : (7 + c) * count]
            first, both, second = crossed[c, i, :count], crossed[c, i, count:], squared[c, i]
            for k in range(count):
                mean_w, mean_t = mean[k] * common[k], first[k] * common[k]
                var_w = max(square[k] * common[k] - mean_w * mean_w, zero)
                var_t = max(second[k] * common[k] - mean_t * mean_t, zero)
                w = channel * np.sqrt(var_t)
                color[k] += w * (both[k] * common[k] - mean_w * mean_t) / (np.sqrt(var_w * var_t) + floor)
                weights[k] += w
        mean, square = sums[5 * count : 6 * count], sums[9 * count :]
        first, both, second = crossed[3, i, :count], crossed[3, i, count:], squared[3, i]
        for k in range(count):
            apart = (mean[k] - first[k]) * common[k]
            deviation[k] = max((square[k] + second[k] - both[k] - both[k]) * common[k] - apart * apart, zero)
            without_depth[k] = (
                color[k] / weights[k]
                + np.float32(OVERLAP_WEIGHT) * sums[k] / window_area[k]
                - free * sums[count + k]
                + full * sums[k]
            )
        for g in range(which.shape[0]):
            best = -1e9
            for k in range(places):
                now = without_depth[g * places + k]
                if now + DEPTH_WEIGHT <= best:
                    continue  # Not even a perfect relief would help.
                total = now + DEPTH_WEIGHT * np.exp(-deviation[g * places + k] * sharpness)
                if total > best:
                    best = total
                    which[g, i] = k
            scores[g, i] = best
