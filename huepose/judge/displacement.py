"""A texture that lies a little elsewhere than the mesh has it: labels are glued on by hand, textures
stitched.

On scanned objects the texture is off by one to three hundredths of what one sees of them. Fine detail then
correlates with nothing, and a pose can win because a wrong part of the texture happens to lie better. So a
texture may be moved as a whole before it is compared: an affine map of the picture, small by its prior, found
by robust Gauss-Newton steps (B. Lucas, T. Kanade: An iterative image registration technique, IJCAI 1981).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64

SPREAD = 0.01
"""Displacement of a texture, as a share of the diagonal of what shows of it: one standard deviation."""

LEVELS = ((4, 5), (2, 4))
"""Pictures shrunk by the first number, so many steps on each, coarse to fine."""

LARGEST_STEP_PX = 2.0
WEAKEST, STRONGEST = 0.2, 1.5
"""Of a texture in the picture against that of the mesh: gloss veils it."""

FEWEST = 30
"""Pixels of a level on which a texture can be aligned."""


class Moved(NamedTuple):
    """An affine map of the picture: a pixel x goes to x + A (x - center, 1) / spread with A (2, 3), the last
    column in pixels of displacement at the center."""

    A: Float64
    center: Float64
    spread: float


def aligned(picture: Float32, texture: Float32, there: Bool) -> Float32:
    """The texture (h, w, C), moved to where it suits the picture (h, w, C) best; its first channel decides.

    `there` (h, w) is where the texture shows. Returned unmoved where that is too little.
    """
    rows, columns = np.nonzero(there)
    if len(rows) < FEWEST:
        return texture
    center = np.array([columns.mean(), rows.mean()])
    spread = max(float(columns.std()), float(rows.std()), 1.0)
    spread_px = SPREAD * float(np.hypot(np.ptp(columns), np.ptp(rows)))
    moved = Moved(np.zeros((2, 3)), center, spread)
    shown = there.astype(np.float32)
    own = texture[..., 0] * shown
    for shrink, steps in LEVELS:
        moved = _at_level(picture[..., 0], own, shown, moved, spread_px, shrink, steps)
    x, y = _grid(there.shape[0], there.shape[1], 1, moved)
    return _warped(texture, *_from(x, y, moved, 1))


def _at_level(
    picture: Float32,
    texture: Float32,
    shown: Float32,
    moved: Moved,
    spread_px: float,
    shrink: int,
    steps: int,
) -> Moved:
    small = [_shrunk(image, shrink) for image in (picture, texture, shown)]
    target, source, weight = small
    across = cv2.Sobel(source, cv2.CV_32F, 1, 0, ksize=3) / (8.0 * shrink)
    down = cv2.Sobel(source, cv2.CV_32F, 0, 1, ksize=3) / (8.0 * shrink)
    stack = np.dstack([source, across, down, weight])
    x, y = _grid(source.shape[0], source.shape[1], shrink, moved)
    A = moved.A
    for _ in range(steps):
        current = Moved(A, moved.center, moved.spread)
        values = _warped(stack, *_from(x, y, current, shrink))
        inside = values[..., 3] > 0.5
        if int(inside.sum()) < FEWEST:
            break
        A = A + _step(target[inside], values[inside], x[inside], y[inside], A, spread_px)
    return Moved(A, moved.center, moved.spread)


def _step(target: Float32, values: Float32, x: Float32, y: Float32, A: Float64, spread_px: float) -> Float64:
    """One robust Gauss-Newton step (2, 3) towards the target's values (N,), with the prior's pull to none."""
    source, across, down = values[:, 0], values[:, 1], values[:, 2]
    gain = np.clip(float(target @ source) / (float(source @ source) + 1e-6), WEAKEST, STRONGEST)
    left = target - gain * source
    noise = 1.5 * float(np.median(np.abs(left))) + 1e-3
    weight = 1.0 / (1.0 + (left / noise) ** 2)
    slope = -gain * np.stack([across * x, across * y, across, down * x, down * y, down], axis=-1)
    weighed = slope * weight[:, None]
    prior = (noise / spread_px) ** 2 * np.array([4.0, 4.0, 1.0, 4.0, 4.0, 1.0])
    system = weighed.T @ slope + np.diag(prior + 1e-6)
    step = np.linalg.solve(system.astype(np.float64), weighed.T @ left - prior * A.ravel())
    return np.clip(step, -LARGEST_STEP_PX, LARGEST_STEP_PX).reshape(2, 3)


def _shrunk(image: Float32, shrink: int) -> Float32:
    """A picture (h, w), smoothed and shrunk."""
    height, width = image.shape
    size = (max(width // shrink, 2), max(height // shrink, 2))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), 0.7), dtype=np.float32)


def _grid(height: int, width: int, shrink: int, moved: Moved) -> tuple[Float32, Float32]:
    """Where the pixels (height, width) of a level lie, from the center, in units of the spread."""
    columns = (np.arange(width, dtype=np.float32) + 0.5) * shrink - 0.5
    rows = (np.arange(height, dtype=np.float32) + 0.5) * shrink - 0.5
    x, y = np.meshgrid((columns - moved.center[0]) / moved.spread, (rows - moved.center[1]) / moved.spread)
    return x.astype(np.float32), y.astype(np.float32)


def _from(x: Float32, y: Float32, moved: Moved, shrink: int) -> tuple[Float32, Float32]:
    """The places (h, w) of a level that come to lie on its pixels."""
    A, (cx, cy), spread = moved
    u = x * spread + cx - (A[0, 0] * x + A[0, 1] * y + A[0, 2])
    v = y * spread + cy - (A[1, 0] * x + A[1, 1] * y + A[1, 2])
    return (
        np.asarray((u + 0.5) / shrink - 0.5, dtype=np.float32),
        np.asarray((v + 0.5) / shrink - 0.5, dtype=np.float32),
    )


def _warped(image: Float32, u: Float32, v: Float32) -> Float32:
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.float32)
