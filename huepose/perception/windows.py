"""Where an object could be, and what is seen there: windows of its size, in a few cells."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.perception.clear_view import ClearView
from huepose.propose.template_table import COARSE_SIDE, MILLIMETRES
from huepose.support.jit import jit

SPACING = 0.2
"""Distance of windows, in diameters."""

LATTICE_PX = 3
BIG = 1 << 20
CHANNELS = 6
SAMPLES = 3
MIN_SHARE = 0.2
"""Samples a cell and axis."""

BORDER = 2
"""The middle, which tells what hue is there, are the cells so far from the sides."""

GATE = 0.6
"""Depth farther than this from the middle of a window, in diameters, is not the object."""


@dataclass(frozen=True, eq=False)
class Windows:
    """W windows of one object's size. pixels (W, 2): their middles in the view; depth_m (W,): there;
    span_px (W,): their sides; cells (W, P, 6) float32: opponents, relief in mm from depth_m, share that could
    be the object, share of background behind it; pieces: how many of them, the first ones, are of pieces."""

    pixels: Float64
    depth_m: Float64
    span_px: Float64
    cells: Float32
    pieces: int

    def __len__(self) -> int:
        return len(self.pixels)

    def __getitem__(self, index: np.ndarray) -> Windows:
        return Windows(self.pixels[index], self.depth_m[index], self.span_px[index], self.cells[index], 0)


def windows_of(view: ClearView, diameter_m: float, span_m: float) -> Windows:
    """Windows of `span_m` over all that stands in the view, a fifth of a diameter apart, of which only the
    cells of the middle are filled."""
    pieces = view.pieces
    fitting = (pieces[:, 3] > 0.2 * diameter_m) & (pieces[:, 3] < 1.3 * diameter_m)
    grid = _places(view.clear, view.crop.depth, view.crop.camera.fx, SPACING * diameter_m)
    places = np.concatenate([pieces[fitting, :3], grid])
    span_px = span_m / places[:, 2] * view.crop.camera.fx
    empty = np.zeros((len(places), 0, CHANNELS), np.float32)
    windows = Windows(places[:, :2].copy(), places[:, 2].copy(), span_px, empty, int(fitting.sum()))
    return filled(windows, view, diameter_m, BORDER)


def filled(windows: Windows, view: ClearView, diameter_m: float, border: int = 0) -> Windows:
    """The same windows with their cells filled, but for so many rows of them at each side."""
    cells = np.zeros((len(windows), COARSE_SIDE * COARSE_SIDE, CHANNELS), np.float32)
    _fill(
        windows.pixels, windows.depth_m, windows.span_px, view.clear, view.crop.depth, view.colors,
        GATE * diameter_m, border, cells,
    )  # fmt: skip
    return replace(windows, cells=cells)


def _places(clear: Bool, depth: Float32, focal: float, spacing_m: float) -> Float64:
    """Middles (W, 3): pixel and depth, of the points that fall into each cube of space."""
    v, u = (LATTICE_PX * k for k in np.nonzero(clear[::LATTICE_PX, ::LATTICE_PX]))
    z = depth[v, u].astype(np.float64)
    cube = np.floor(np.stack([u * z / focal, v * z / focal, z * 0.5]) / spacing_m).astype(np.int64)
    key = (cube[0] * BIG + cube[1]) * BIG + cube[2]
    _, owner, count = np.unique(key, return_inverse=True, return_counts=True)
    sums = [np.bincount(owner, x, len(count)) for x in (u, v, z)]
    return np.asarray(np.stack(sums, -1) / count[:, None])


@jit
def _fill(
    pixels: Float64,
    depth_m: Float64,
    span_px: Float64,
    clear: Bool,
    depth: Float32,
    colors: Float32,
    gate_m: float,
    border: int,
    cells: Float32,
) -> None:
    height, width = clear.shape
    n = COARSE_SIDE * SAMPLES
    each = np.float32(1.0 / (SAMPLES * SAMPLES))
    first, last = border * SAMPLES, n - border * SAMPLES
    for w in range(pixels.shape[0]):
        step = span_px[w] / n
        middle = depth_m[w]
        left, top = pixels[w, 0] - 0.5 * (n - 1) * step, pixels[w, 1] - 0.5 * (n - 1) * step
        for y in range(first, last):
            v = int(np.floor(top + y * step + 0.5))
            if v < 0 or v >= height:
                continue
            row = y // SAMPLES * COARSE_SIDE
            for x in range(first, last):
                u = int(np.floor(left + x * step + 0.5))
                if u < 0 or u >= width or depth[v, u] == 0.0:
                    continue
                cell = cells[w, row + x // SAMPLES]
                away = depth[v, u] - middle
                if clear[v, u] and abs(away) < gate_m:
                    # The wider smoothing stands for the mean of the samples between.
                    cell[0] += colors[v, u, 3]
                    cell[1] += colors[v, u, 4]
                    cell[2] += colors[v, u, 5]
                    cell[3] += np.float32(away)
                    cell[4] += each
                elif away > 0.0:
                    cell[5] += each
        for k in range(cells.shape[1]):
            cell = cells[w, k]
            if cell[4] > np.float32(MIN_SHARE):
                for c in range(4):
                    cell[c] *= each / cell[4]
                cell[3] *= np.float32(MILLIMETRES)
            else:
                for c in range(5):
                    cell[c] = np.float32(0.0)
