"""What the network of view codes looks at: small pictures of colour and relief at metric scale.

A model's clean views and windows of a frame come in the same form, 1.1 diameters wide, so that one network
reads both. Training draws its windows with the same functions.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Float32, Float64, UInt8
from huepose.geometry.camera import Camera
from huepose.geometry.mesh import Mesh
from huepose.propose.templates import DISTANCE_DIAMETERS, DISTANCE_M, SPAN
from huepose.rendering.render import render

SIDE = 64
"""Pixels a side of what the network sees."""

LEVEL, ROLLS = 1, 12
"""Views: directions of the icosphere (42, 32 degrees apart) times rolls. Nobody is farther from one of them
than half of that, which training teaches the network to bridge."""

CHANNELS = 6
NEAR = 0.6
"""Relief beyond this many diameters is not the object; it is clipped there."""

UNTURNED = 92
"""Side of a view from which one of any roll is cut: sqrt(2) * SIDE, rounded up."""

_FINER = 2
"""Pixels of the rendering per pixel of a view."""

_ROOM = 1.6
"""Width of the rendering in widths of a view: its middle is that of what is seen, not of the mesh."""

_SOFT_PX = 0.7
"""Deviation of the blur before every second pixel of the rendering is taken."""

MAX_STEP = 1.7
"""A frame that is larger than this times the window is halved before it is sampled."""


def unturned_views(mesh: Mesh, diameter_m: float) -> tuple[UInt8, Float32]:
    """Colours (V, 92, 92, 3), black where nothing is, and relief (V, 92, 92) in diameters from the median
    depth, NaN where nothing is, of the views from all directions without a roll."""
    looks = [icosphere.look_at(direction) for direction in icosphere.directions(LEVEL)]
    views = [clean_view(mesh, diameter_m, R, UNTURNED) for R in looks]
    return np.stack([view.color for view in views]), np.stack([view.relief for view in views])


@dataclass(frozen=True, eq=False)
class CleanView:
    """A model seen alone: color (n, n, 3), relief (n, n), as of `unturned_views`; middle_m (3,): from the
    mesh's centre to the view's middle at median depth, in the camera's axes."""

    color: UInt8
    relief: Float32
    middle_m: Float64


def clean_view(mesh: Mesh, diameter_m: float, R_cam_obj: Float64, side: int = SIDE) -> CleanView:
    """The view of a mesh in one turn (3, 3) on the optical axis."""
    distance = max(DISTANCE_M, DISTANCE_DIAMETERS * diameter_m)
    focal = _FINER * SIDE * distance / (SPAN * diameter_m)
    wide = int(_ROOM * SPAN * _FINER * SIDE)
    camera = Camera(focal, focal, wide / 2 - 0.5, wide / 2 - 0.5, wide, wide)
    seen = render([(mesh, se3.make(R_cam_obj, [0.0, 0.0, distance] - R_cam_obj @ mesh.centre))], camera)
    rows, columns = np.nonzero(seen.depth)
    middle = np.array([columns.mean(), rows.mean()])
    median = float(np.median(seen.depth[rows, columns]))
    to_picture = _lattice(middle, _FINER * distance / median, side)
    soft = np.asarray(cv2.GaussianBlur(seen.color, (0, 0), _SOFT_PX), np.uint8)
    depth = _warped(seen.depth, to_picture, side, cv2.INTER_NEAREST)
    there = (depth > 0)[..., None]
    relief = np.where(depth > 0, (depth - np.float32(median)) / np.float32(diameter_m), np.float32(np.nan))
    color = np.where(there, _warped(soft, to_picture, side, cv2.INTER_LINEAR), 0).astype(np.uint8)
    point = camera.backproject(middle[None], np.array([median]))[0]
    return CleanView(color, relief, point - np.array([0.0, 0.0, distance]))


def turned(colors: UInt8, reliefs: Float32) -> tuple[UInt8, Float32]:
    """Views (V * 12, 64, 64, 3) and (V * 12, 64, 64) at all rolls, of unturned ones: in the order of a
    `TemplateTable` of 12 rolls."""
    out_colors = np.zeros((len(colors), ROLLS, SIDE, SIDE, 3), np.uint8)
    out_reliefs = np.full((len(colors), ROLLS, SIDE, SIDE), np.nan, np.float32)
    for r, angle in enumerate(2 * np.pi * np.arange(ROLLS) / ROLLS):
        c, s = np.cos(angle), np.sin(angle)
        A = np.array([[c, s], [-s, c]])
        back = np.column_stack([A, (UNTURNED - 1) / 2.0 - A @ np.full(2, (SIDE - 1) / 2.0)])
        for v in range(len(colors)):
            out_colors[v, r] = _warped(colors[v], back, SIDE, cv2.INTER_LINEAR)
            out_reliefs[v, r] = _warped(reliefs[v], back, SIDE, cv2.INTER_NEAREST, np.nan)
    return out_colors.reshape(-1, SIDE, SIDE, 3), out_reliefs.reshape(-1, SIDE, SIDE)


def window_pictures(
    color: UInt8,
    depth: Float32,
    pixels: Float64,
    depth_m: Float64,
    span_px: Float64,
    diameter_m: float | Float64,
    wide: int = 1,
) -> tuple[UInt8, Float32]:
    """Colours (W, 64, 64, 3) and relief (W, 64, 64) in diameters, NaN where the depth is unknown, of windows
    with their middles at pixels (W, 2) and depths (W,), `span_px` (W,) wide, of a picture (H, W, 3) with
    depth (H, W) metres. diameter_m: of one object, or of each window's (W,). wide: so many times as wide, and
    of as many more pixels (training)."""
    side = wide * SIDE
    smaller, diameters = [color], np.broadcast_to(diameter_m, len(pixels))
    colors = np.zeros((len(pixels), side, side, 3), np.uint8)
    reliefs = np.full((len(pixels), side, side), np.nan, np.float32)
    for k in range(len(pixels)):
        step = float(span_px[k]) / SIDE
        halvings = max(0, int(np.ceil(np.log2(step / MAX_STEP))))
        while len(smaller) <= halvings:
            smaller.append(np.asarray(cv2.pyrDown(smaller[-1]), np.uint8))
        to_picture = _lattice(pixels[k], step, side)
        to_smaller = to_picture / 2**halvings
        to_smaller[:, 2] += 0.5 * (0.5**halvings - 1.0)  # pixel centres of a halved picture lie between
        colors[k] = _warped(smaller[halvings], to_smaller, side, cv2.INTER_LINEAR)
        z = _warped(depth, to_picture, side, cv2.INTER_NEAREST)
        known = z > 0
        reliefs[k][known] = (z[known] - np.float32(depth_m[k])) / np.float32(diameters[k])
    return colors, reliefs


def network_input(colors: UInt8, reliefs: Float32, *, clean: bool) -> Float32:
    """The input (N, 6, 64, 64): red, green, blue from -1 to 1, relief, whether it is known, whether it is
    near. clean: of a model's views, where what is not covered has no colour either."""
    known = np.isfinite(reliefs)
    relief = np.where(known, reliefs, np.float32(0.0))
    x = np.empty((len(colors), CHANNELS, SIDE, SIDE), np.float32)
    np.multiply(colors.transpose(0, 3, 1, 2), np.float32(2.0 / 255.0), out=x[:, :3])
    x[:, :3] -= np.float32(1.0)
    if clean:
        x[:, :3] *= known[:, None]
    np.multiply(np.clip(relief, -NEAR, NEAR), np.float32(2.0), out=x[:, 3])
    x[:, 4] = known
    x[:, 5] = known & (np.abs(relief) < NEAR)
    return x


def _lattice(middle: Float64, step: float, side: int) -> Float64:
    """The map (2, 3) from a lattice of `side` points, `step` pixels apart about a pixel (2,), to the
    picture."""
    corner = middle - (side - 1) / 2.0 * step
    return np.array([[step, 0.0, corner[0]], [0.0, step, corner[1]]])


def _warped(image: np.ndarray, to_image: Float64, side: int, how: int, outside: float = 0.0) -> np.ndarray:
    return cv2.warpAffine(
        image, to_image, (side, side), flags=how | cv2.WARP_INVERSE_MAP, borderValue=4 * (outside,)
    )
