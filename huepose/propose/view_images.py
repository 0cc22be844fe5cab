"""Input images of the view-code network: colour and relief (depth from the median) at metric scale.

Rendered views of a model and windows of a frame have the same form, 1.1 diameters wide, so that one network
encodes both. Training uses the same functions.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Float32, Float64, UInt8, UInt64, median
from huepose.geometry.camera import Camera
from huepose.geometry.mesh import Mesh
from huepose.propose.templates import DISTANCE_DIAMETERS, DISTANCE_M, SPAN
from huepose.rendering.render import render
from huepose.support.jit import jit_dividing

SIDE = 64
"""Side of an input image, pixels."""

LEVEL, ROLLS = 1, 12
"""Views: directions of the icosphere (42, 32 degrees apart) times rolls. No direction is farther than half
of that from the nearest view; training covers these differences."""

CHANNELS, PLACES = 6, 8
"""Channels of the input, see `network_input`; and bytes of a pixel there, as many as processors like to
read at once."""

NEAR = 0.6
"""Largest relief that can belong to the object, in diameters from the median depth; relief is clipped
there."""

STEP, ZERO = np.float32(4.0 * NEAR) / np.float32(255.0), 128
"""A byte of the input means the number (byte - ZERO) * STEP, -1.2 to 1.2."""

UPRIGHT_PX = 92
"""Side of an unrolled view, pixels: sqrt(2) * SIDE plus a margin, so that a view at any roll can be cut from
it."""

_OVERSAMPLING = 2
"""Rendered pixels per pixel of a view, along each axis."""

_MARGIN = 1.6
"""Width of the rendering over that of a view: the view is centred on the visible pixels, not on the mesh."""

_BLUR_PX = 0.7
"""Sigma of the anti-aliasing blur before the rendering is subsampled, rendered pixels."""

MAX_STEP = 1.7
"""Largest sampling step, pixels: a coarser step takes the next level of the image pyramid."""


def upright_views(mesh: Mesh, diameter_m: float) -> tuple[UInt8, Float32]:
    """The views of a mesh from all directions, without roll: colours (V, 92, 92, 3) uint8, black outside the
    object, and relief (V, 92, 92) in diameters from the median depth, NaN outside."""
    looks = [icosphere.look_at(direction) for direction in icosphere.directions(LEVEL)]
    views = [clean_view(mesh, diameter_m, R, UPRIGHT_PX) for R in looks]
    return np.stack([view.color for view in views]), np.stack([view.relief for view in views])


@dataclass(frozen=True, eq=False)
class CleanView:
    """One rendered view: color (n, n, 3), relief (n, n), as of `upright_views`; middle_m (3,): from the
    mesh's centre to the centre of the view at median depth, camera axes."""

    color: UInt8
    relief: Float32
    middle_m: Float64


def clean_view(mesh: Mesh, diameter_m: float, R_cam_obj: Float64, side: int = SIDE) -> CleanView:
    """Render a mesh on the optical axis with the rotation R_cam_obj (3, 3). side: of the view, pixels."""
    distance = max(DISTANCE_M, DISTANCE_DIAMETERS * diameter_m)
    focal = _OVERSAMPLING * SIDE * distance / (SPAN * diameter_m)
    wide = int(_MARGIN * SPAN * _OVERSAMPLING * SIDE)
    camera = Camera(focal, focal, wide / 2 - 0.5, wide / 2 - 0.5, wide, wide)
    rendering = render([(mesh, se3.make(R_cam_obj, [0.0, 0.0, distance] - R_cam_obj @ mesh.centre))], camera)
    shown = rendering.depth > 0
    rows, columns = np.divmod(np.flatnonzero(shown), wide)
    if len(rows):
        middle, median_m = np.array([columns.mean(), rows.mean()]), median(rendering.depth[shown])
    else:  # thinner than a pixel from here
        middle, median_m = np.array([camera.cx, camera.cy]), distance
    step = np.array([_OVERSAMPLING * distance / median_m])
    (to_image,) = _lattices_to_image(middle[None], step, side)
    blurred = np.asarray(cv2.GaussianBlur(rendering.color, (0, 0), _BLUR_PX), np.uint8)
    depth = _resampled(rendering.depth, to_image, side, cv2.INTER_NEAREST)
    there = (depth > 0)[..., None]
    relief = np.where(depth > 0, (depth - np.float32(median_m)) / np.float32(diameter_m), np.float32(np.nan))
    color = np.where(there, _resampled(blurred, to_image, side, cv2.INTER_LINEAR), 0).astype(np.uint8)
    point = camera.backproject(middle[None], np.array([median_m]))[0]
    return CleanView(color, relief, point - np.array([0.0, 0.0, distance]))


def turned(colors: UInt8, reliefs: Float32) -> tuple[UInt8, Float32]:
    """Views at all rolls from unrolled ones: colours (V * 12, 64, 64, 3) and relief (V * 12, 64, 64), views
    first, as in a `TemplateTable` of 12 rolls."""
    out_colors = np.zeros((len(colors), ROLLS, SIDE, SIDE, 3), np.uint8)
    out_reliefs = np.full((len(colors), ROLLS, SIDE, SIDE), np.nan, np.float32)
    for r, angle in enumerate(2 * np.pi * np.arange(ROLLS) / ROLLS):
        c, s = np.cos(angle), np.sin(angle)
        A = np.array([[c, s], [-s, c]])
        back = np.column_stack([A, (UPRIGHT_PX - 1) / 2.0 - A @ np.full(2, (SIDE - 1) / 2.0)])
        for v in range(len(colors)):
            out_colors[v, r] = _resampled(colors[v], back, SIDE, cv2.INTER_LINEAR)
            out_reliefs[v, r] = _resampled(reliefs[v], back, SIDE, cv2.INTER_NEAREST, np.nan)
    return out_colors.reshape(-1, SIDE, SIDE, 3), out_reliefs.reshape(-1, SIDE, SIDE)


class Pyramid:
    """An image (H, W, 3) uint8 and its halvings, each computed at the first request. Thread-safe."""

    def __init__(self, color: UInt8) -> None:
        self._levels, self._lock = [color], threading.Lock()

    def halved(self, times: int) -> UInt8:
        """The image after this many halvings of its sides."""
        with self._lock:
            while len(self._levels) <= times:
                self._levels.append(np.asarray(cv2.pyrDown(self._levels[-1]), np.uint8))
            return self._levels[times]


def window_images(
    image: Pyramid,
    depth: Float32,
    pixels: Float64,
    depth_m: Float64,
    span_px: Float64,
    diameter_m: float | Float64,
    wide: int = 1,
) -> tuple[UInt8, Float32]:
    """Cut windows from a frame: colours (W, 64, 64, 3) and relief (W, 64, 64) in diameters, NaN where depth
    is unknown.

    image, depth (H, W) metres: the frame; pixels (W, 2), depth_m (W,): centres; span_px (W,): widths in
    pixels. diameter_m: of the object, or one per window (W,). wide: factor on width and pixels
    (training)."""
    side, step = wide * SIDE, span_px / SIDE
    to_image = _lattices_to_image(pixels, step, side)
    halvings = np.maximum(0, np.ceil(np.log2(step / MAX_STEP))).astype(int)
    to_smaller = to_image / 2.0 ** halvings[:, None, None]
    # This assumes that the pixels of a halved image lie between those of the larger one. In fact pyrDown
    # puts them on every second one. The network was trained with this (docs/tried.md, "Windows without a
    # displacement").
    to_smaller[:, :, 2] += 0.5 * (0.5 ** halvings[:, None] - 1.0)
    colors = np.empty((len(pixels), side, side, 3), np.uint8)
    for k, halving in enumerate(halvings):
        _resampled(image.halved(halving), to_smaller[k], side, cv2.INTER_LINEAR, out=colors[k])
    reliefs = np.empty((len(pixels), side, side), np.float32)
    _gaps(depth, to_image, np.asarray(depth_m, np.float32), reliefs)
    reliefs /= np.broadcast_to(diameter_m, len(pixels)).astype(np.float32)[:, None, None]
    return colors, reliefs


@jit_dividing
def _gaps(depth: Float32, to_image: Float64, depth_m: Float32, out: Float32) -> None:
    """Fill `out` (W, n, n) with the depth of the pixel nearest to each point of upright lattices, minus the
    depth of their middle (W,); NaN where it is unknown."""
    height, width = depth.shape
    side, nothing = out.shape[1], np.float32(np.nan)
    # Unsigned, so that the compiler need not handle negative indices.
    columns, inside = np.empty(side, np.uint64), np.empty(side, np.bool_)
    for k in range(out.shape[0]):
        step, left, top = to_image[k, 0, 0], to_image[k, 0, 2] + 0.5, to_image[k, 1, 2] + 0.5
        middle = depth_m[k]
        for x in range(side):
            u = int(np.floor(step * x + left))
            inside[x] = 0 <= u < width
            columns[x] = np.uint64(u if inside[x] else 0)
        for y in range(side):
            v = int(np.floor(step * y + top))
            if v < 0 or v >= height:
                out[k, y] = nothing
                continue
            row = np.uint64(v)
            for x in range(side):
                z = depth[row, columns[x]]
                out[k, y, x] = z - middle if inside[x] and z > 0.0 else nothing


def network_input(colors: UInt8, reliefs: Float32, *, clean: bool) -> UInt8:
    """Network input (N, 64, 64, 8), as bytes in units of STEP: red, green, blue in -1..1; relief, clipped
    at NEAR and doubled; 1 where relief is known; 1 where it is within NEAR; two unused bytes. clean: for
    rendered views, whose colour is set to 0 outside the object."""
    pixels = np.empty((len(colors), SIDE, SIDE), np.uint64)
    _fill(colors, reliefs, clean, _LEVELS, _NO_COLOR, _KNOWN, pixels)
    return pixels.view(np.uint8).reshape(*pixels.shape, PLACES)


def as_bytes(numbers: Float32) -> UInt8:
    """The nearest bytes of the input for numbers of any shape; of two equally near ones the even one."""
    return np.asarray(np.clip(np.rint(numbers / STEP) + ZERO, 0, 255), np.uint8)


def _in_places(first: int, *numbers: Float32) -> UInt64:
    """What numbers (N,) in consecutive bytes of a pixel, from `first` on, add to that pixel (N,) as one
    integer."""
    bytes_ = np.zeros((len(numbers[0]), PLACES), np.uint8)
    bytes_[:, first : first + len(numbers)] = as_bytes(np.stack(numbers, 1))
    return bytes_.view(np.uint64)[:, 0]


_RELIEF_PLACE = 3
_COLORS = np.arange(256, dtype=np.float32) * np.float32(2.0 / 255.0) - np.float32(1.0)
_LEVELS = np.stack([_in_places(channel, _COLORS) for channel in range(3)])
_NO_COLOR = _in_places(0, *np.zeros((3, 1), np.float32))[0]
_KNOWN = _in_places(4, *np.array([[0, 1, 1], [0, 0, 1]], np.float32))
"""For a pixel whose relief is unknown, known, and within NEAR."""


@jit_dividing
def _fill(
    colors: UInt8,
    reliefs: Float32,
    clean: bool,
    levels: UInt64,
    no_color: np.uint64,
    known: UInt64,
    pixels: UInt64,
) -> None:
    near, step, place = np.float32(NEAR), np.float64(STEP), np.uint64(8 * _RELIEF_PLACE)
    heights, state = np.empty(SIDE, np.int64), np.empty(SIDE, np.int64)
    for n in range(pixels.shape[0]):
        for v in range(SIDE):
            for u in range(SIDE):
                z = reliefs[n, v, u]
                finite = np.isfinite(z)
                z = z if finite else np.float32(0.0)
                # Rounds like a quotient of single precision; a product with the reciprocal would not.
                share = np.float32(np.float64(min(max(z, -near), near) * np.float32(2.0)) / step)
                heights[u] = min(int(np.rint(share)) + ZERO, 255)
                state[u] = np.int64(finite) + np.int64(finite and abs(z) < near)
            for u in range(SIDE):
                pixel = known[state[u]] + (np.uint64(heights[u]) << place)
                if clean and state[u] == 0:
                    pixel += no_color
                else:
                    for c in range(3):
                        pixel += levels[c, colors[n, v, u, c]]
                pixels[n, v, u] = pixel


def _lattices_to_image(middles: Float64, steps: Float64, side: int) -> Float64:
    """Affine maps (N, 2, 3) to the image from lattices of `side` points a side, `steps` (N,) pixels apart,
    centred on pixels (N, 2)."""
    out = np.zeros((len(middles), 2, 3))
    out[:, 0, 0] = out[:, 1, 1] = steps
    out[:, :, 2] = middles - (side - 1) / 2.0 * steps[:, None]
    return out


def _resampled(
    image: np.ndarray,
    to_image: Float64,
    side: int,
    how: int,
    outside: float = 0.0,
    out: np.ndarray | None = None,
) -> np.ndarray:
    return cv2.warpAffine(
        image, to_image, (side, side), out, flags=how | cv2.WARP_INVERSE_MAP, borderValue=4 * (outside,)
    )
