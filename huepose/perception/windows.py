"""Sliding windows of an object's metric size over a view, and their features: coarse cells and view codes.

Objects of nearly the same diameter share their windows, so each window is cut and encoded once for all of
them.
"""

from __future__ import annotations

import threading
from functools import cached_property
from math import log

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int64
from huepose.perception.clear_view import ClearView
from huepose.perception.memory import KeptWindows, Memory, matched, until
from huepose.propose.templates import COARSE_SIDE, MILLIMETRES, SPAN
from huepose.propose.view_codes import CELLS as CODE_CELLS
from huepose.propose.view_codes import NUMBERS, codes_of_windows
from huepose.propose.view_images import NEAR, window_images
from huepose.support.jit import jit
from huepose.support.stages import stage

SPACING = 0.25
"""Spacing of windows, in diameters. An object's middle is then no farther from the middle of a window than
in the training of the codes (`training.view_codes.LARGEST_SHIFT`)."""

SIZES = 1.15
"""Ratio of neighbouring window sizes: a window is at most 7 % too large or too small, as in training
(`training.view_codes.STRETCH`)."""

LATTICE_PX = 3
"""Windows are placed by every third pixel along each axis."""

BIG = 1 << 20
"""More than the number of cubes along any axis: used to number the cubes."""

CHANNELS = 6
"""Channels of a cell: three opponent colours, relief, share of the object's depth, share of background."""

SAMPLES = 3
"""Samples of a cell along each axis."""

MIN_SHARE = 0.2
"""A cell is known if more than this share of its samples lies at the object's depth."""

BORDER = 2
"""Cells from each side that do not belong to a window's middle. The hue of the middle orders the
windows."""


class Windows:
    """All W windows of one size in a view. Features are computed at the first request; thread-safe.

    known: windows of earlier looks whose content has not changed; look: number of this look; diameter_m: of
    the objects that the windows suit; pixels (W, 2): centres in the view; depth_m (W,): depth at the
    centre; span_px (W,): side length; pieces: how many windows, the first ones, are centred on separate
    pieces of the depth; recalled (W,): which windows come from `known`."""

    def __init__(
        self, view: ClearView, diameter_m: float, known: KeptWindows | None = None, look: int = 0
    ) -> None:
        pieces, focal = view.pieces, view.crop.camera.fx
        fitting = (pieces[:, 3] > 0.2 * diameter_m) & (pieces[:, 3] < 1.3 * diameter_m)
        grid = _places(view.clear, view.crop.depth, focal, SPACING * diameter_m)
        places = np.concatenate([pieces[fitting, :3], grid])
        self.diameter_m, self.pieces = diameter_m, int(fitting.sum())
        self.pixels, self.depth_m = places[:, :2].copy(), places[:, 2].copy()
        self.span_px = SPAN * diameter_m / places[:, 2] * focal
        self._view, self._focal = view, focal
        self._codes = np.zeros((len(places), NUMBERS * CODE_CELLS**2), np.float32)
        self._coded = np.zeros(len(places), bool)
        self._look, self._until = np.full(len(places), look), until(look, len(places))
        self.recalled = np.zeros(len(places), bool)
        self._lock = threading.Lock()
        if known is not None:
            self._recall(known)

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def frame_pixels(self) -> Float64:
        """The centres (W, 2) in the frame."""
        crop = self._view.crop
        return np.asarray(self.pixels + np.array([crop.x0, crop.y0]))

    def uncoded(self, index: Int64) -> int:
        """How many of windows (K,) have no codes yet."""
        return int((~self._coded[index]).sum())

    def places_diameters(self, index: Int64) -> Float64:
        """Centres (K, 3) of windows (K,) in space, in diameters; depth is halved, as in the grid of
        windows."""
        return self._in_diameters(self.pixels[index], self.depth_m[index])

    def _in_diameters(self, pixels: Float64, depth_m: Float64) -> Float64:
        across = pixels * (depth_m / self._focal)[:, None]
        return np.asarray(np.column_stack([across, 0.5 * depth_m]) / self.diameter_m, np.float64)

    def _recall(self, known: KeptWindows) -> None:
        """Move each window that matches a known one to that one's place, and give it its codes."""
        crop = self._view.crop
        pixels = known.pixels - [crop.x0, crop.y0]
        before = self._in_diameters(pixels, known.depth_m)
        mine, theirs = matched(self.places_diameters(np.arange(len(self))), before)
        self.pixels[mine], self.depth_m[mine] = pixels[theirs], known.depth_m[theirs]
        self.span_px[mine], self._codes[mine] = known.span_px[theirs], known.codes[theirs]
        self._look[mine], self._until[mine] = known.look[theirs], known.until[theirs]
        self._coded[mine] = self.recalled[mine] = True

    def kept(self) -> KeptWindows:
        """The windows whose codes were computed."""
        some = self._coded
        return KeptWindows(
            self.frame_pixels[some], self.depth_m[some], self.span_px[some],
            self._codes[some], self._look[some], self._until[some],
        )  # fmt: skip

    @cached_property
    def middles(self) -> Float32:
        """Like `cells`, for all windows (W, P, 6), with only the cells in the middle filled."""
        return self._filled(np.arange(len(self)), BORDER)

    def cells(self, index: Int64) -> Float32:
        """Cells (K, P, 6) of windows (K,): opponent colours, relief in mm from depth_m, share of samples
        within the object's depth range, share of samples behind it."""
        return self._filled(index, 0)

    def codes(self, index: Int64) -> Float32:
        """View codes (K, D) of windows (K,), each computed once."""
        with self._lock:
            new = index[~self._coded[index]]
            if len(new):
                with stage("codes"):
                    places = self.pixels[new], self.depth_m[new], self.span_px[new]
                    view = self._view
                    pictures = window_images(view.pyramid, view.depth, *places, self.diameter_m)
                    self._codes[new], self._coded[new] = codes_of_windows(*pictures), True
            return np.asarray(self._codes[index])

    def _filled(self, index: Int64, border: int) -> Float32:
        cells = np.zeros((len(index), COARSE_SIDE * COARSE_SIDE, CHANNELS), np.float32)
        view = self._view
        _fill(
            self.pixels[index], self.depth_m[index], self.span_px[index], view.clear, view.crop.depth,
            view.colors[1], NEAR * self.diameter_m, border, cells,
        )  # fmt: skip
        return cells


class WindowsBySize:
    """The windows of a view by size, shared by objects of nearly the same diameter. memory: of earlier
    looks."""

    def __init__(self, view: ClearView, memory: Memory | None = None) -> None:
        self._view, self._memory, self._lock = view, memory, threading.Lock()
        self._of: dict[int, Windows] = {}

    def of(self, diameter_m: float) -> Windows:
        """The windows for an object of this diameter."""
        return self.at(self.size_of(diameter_m))

    @staticmethod
    def size_of(diameter_m: float) -> int:
        """The number of the window size for objects of this diameter."""
        return round(log(diameter_m) / log(SIZES))

    def at(self, size: int) -> Windows:
        """The windows of a size."""
        with self._lock:
            if size not in self._of:
                with stage("windows"):
                    memory, diameter_m = self._memory, float(np.exp(size * log(SIZES)))
                    self._of[size] = (
                        Windows(self._view, diameter_m)
                        if memory is None
                        else Windows(self._view, diameter_m, memory.windows_of(size), memory.look)
                    )
            return self._of[size]

    def kept(self) -> dict[int, KeptWindows]:
        """The windows whose codes were computed, by size."""
        with self._lock:
            return {size: windows.kept() for size, windows in self._of.items()}


def _places(clear: Bool, depth: Float32, focal: float, spacing_m: float) -> Float64:
    """Window centres (W, 3), pixel and depth: the mean of the clear points in each cube of space."""
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
                    # The more smoothed colours, which replace a mean over the pixels between the samples.
                    cell[0] += colors[v, u, 0]
                    cell[1] += colors[v, u, 1]
                    cell[2] += colors[v, u, 2]
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
