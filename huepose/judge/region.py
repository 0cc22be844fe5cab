"""Input of the judges: a crop of the frame with colours smoothed at two scales.

A region is a crop with one mask, or with several candidate masks at once, each with its weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import DARKEST, LINEAR, SCALE
from huepose.geometry.arrays import Bool, Float32, Float64, Int64, UInt8, median
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import COLOR_SCALES_M
from huepose.support.jit import jit_dividing

SATURATED = 250
"""Byte value from which a channel counts as saturated: its colour is unknown."""

HALVED_FROM_PX = 2.0
"""Sigma, pixels, from which smoothing is computed at half resolution."""

OUTSIDE_WEIGHT = 0.02
"""Weight of a pixel without belief when colours are smoothed."""

NOISE_SIGMAS = 1.5
"""A reading within this many standard errors of a surface supports it, however small the object. Chosen on
rendered heaps 1.3 to 2.4 m away and on piles 0.5 to 1.6 m away; two standard errors gave false positives
there."""

MASK_POINTS = 500
"""Most mask points of a region."""


@dataclass(frozen=True, eq=False)
class Crop:
    """A part of a frame. camera: of the crop; x0, y0: its top-left pixel in the frame; color (h, w, 3) uint8
    RGB; depth (h, w) float32 metres, negative for a removed plane, which says nothing about a surface that
    lies in it; saturated (h, w) bool."""

    camera: Camera
    x0: int
    y0: int
    color: UInt8
    depth: Float32
    saturated: Bool


@dataclass(frozen=True, eq=False)
class Region:
    """A crop with a map of what is believed to show the object.

    belief (h, w) float32: how likely a pixel shows the object, 0 without depth (with a single mask: 1 on it).
    mask (h, w): belief over half of its maximum.
    colors (2, h, w, 3) float32: opponents smoothed over about 1 mm and 3.5 mm, inside the mask without mixing
    in its surroundings.
    points_cam (N, 3), point_weights (N,) float64: at most 500 mask points in random order, away from rims,
    and their belief.
    trust: 0..1, how reliable the belief itself is.
    bounds (4,): left, top, right, bottom of the box in the crop.
    tolerance_m: largest difference of depth and surface that counts as agreement; median_depth_m: of the
    mask; sigmas: the tolerance is at least this many standard errors of a reading (see
    `kernel_arrays.tolerance_at`).
    """

    crop: Crop
    belief: Float32
    mask: Bool
    colors: Float32
    points_cam: Float64
    point_weights: Float64
    trust: float
    bounds: Float64
    tolerance_m: float
    median_depth_m: float
    sigmas: float = 0.0

    @staticmethod
    def whole(crop: Crop, mask: Bool, colors: Float32, diameter_m: float, depth_m: float) -> Region:
        """A whole crop, where no outline is known, to score poses of an object of that diameter at about
        `depth_m` or farther, metres."""
        nothing, nowhere = np.zeros(mask.shape, np.float32), np.array([-2.0, -2.0, -1.0, -1.0])
        tolerance, none = tolerance_m(diameter_m, depth_m), np.zeros((0, 3))
        return Region(
            crop, nothing, mask, colors, none, none[:, 0], 0.0, nowhere, tolerance, depth_m, NOISE_SIGMAS
        )


def prepare_crop(frame: RgbdFrame, window: Box) -> Crop:
    """Cut a window (clipped to the image, at least two pixels in each direction) out of a frame."""
    rows, columns = window.slices(frame.camera.width, frame.camera.height)
    x0 = min(columns.start, frame.camera.width - 2)
    y0 = min(rows.start, frame.camera.height - 2)
    x1, y1 = max(columns.stop, x0 + 2), max(rows.stop, y0 + 2)
    # Copies, also of a whole image: for read-only arrays kernels would be compiled once more.
    color = frame.color[y0:y1, x0:x1].copy()
    return Crop(
        frame.camera.cropped(x0, y0, x1 - x0, y1 - y0),
        x0,
        y0,
        color,
        frame.depth[y0:y1, x0:x1].copy(),
        saturated(color),
    )


def saturated(color: UInt8) -> Bool:
    """Which pixels (h, w) of an image (h, w, 3) have a saturated channel."""
    return np.asarray(cv2.inRange(color, (0, 0, 0), (SATURATED - 1,) * 3) == 0)


def prepare_believed(
    crop: Crop, masks: Sequence[Bool], weights: Sequence[float], trust: float, box: Box, diameter_m: float
) -> Region | None:
    """The region of several candidate masks (H, W) of the frame, each with its weight (their sum is
    positive); None if no pixel of any mask has depth in the crop."""
    h, w = crop.depth.shape
    belief = np.zeros((h, w), np.float32)
    for mask, weight in zip(masks, weights, strict=True):
        belief += np.float32(weight) * mask[crop.y0 : crop.y0 + h, crop.x0 : crop.x0 + w]
    belief *= crop.depth > 0
    largest = float(belief.max(initial=0.0))
    if largest <= 0.0:
        return None
    belief *= np.float32(1.0 / max(largest, float(np.sum(weights))))
    seen = belief > 0.5 * belief.max()
    median_depth = median(crop.depth[seen])
    points, point_weights = _believed_points(crop, belief)
    return Region(
        crop,
        belief,
        seen,
        _masked_colors(crop, belief, median_depth),
        points,
        point_weights,
        trust,
        np.array([box.x - crop.x0, box.y - crop.y0, box.x1 - crop.x0, box.y1 - crop.y0], dtype=np.float64),
        tolerance_m(diameter_m, median_depth),
        median_depth,
    )


def least_tolerance_m(diameter_m: float) -> float:
    """Tolerance of depth of an object of that diameter close to the camera: 6 to 12 mm."""
    return max(0.006, min(0.012, 0.05 * diameter_m))


def tolerance_m(diameter_m: float, depth_m: float) -> float:
    """Tolerance of depth, metres: that of the object's size, 2 mm more beyond 1.1 m."""
    return least_tolerance_m(diameter_m) + (0.002 if depth_m > 1.1 else 0.0)


def _masked_colors(crop: Crop, belief: Float32, depth_m: float) -> Float32:
    """Opponents (2, h, w, 3) smoothed at both scales, weighted by belief: inside the mask colours mix only
    with the mask's, outside it with the surroundings'."""
    weight = np.maximum(belief, np.float32(OUTSIDE_WEIGHT))
    # At impossibly small depths, no more than the crop is averaged.
    widest = float(max(crop.depth.shape))
    sigmas = [min(max(0.5, sigma_m / depth_m * crop.camera.fx), widest) for sigma_m in COLOR_SCALES_M]
    return smoothed_opponents(crop.color, weight, sigmas)


def smoothed_opponents(color: UInt8, weight: Float32, sigmas_px: Sequence[float]) -> Float32:
    """Opponents (S, h, w, 3) at each sigma: linear colours of an image (h, w, 3) averaged by a Gaussian,
    pixels weighted by weight (h, w) > 0, then converted."""
    weighted = _weighted(color, weight)
    out = np.empty((len(sigmas_px), *weight.shape, 3), np.float32)
    for sigma, smooth in zip(sigmas_px, out, strict=True):
        if sigma < HALVED_FROM_PX:
            _opponents_of_logs(_smoothed(weighted, sigma), smooth)
        else:
            _smoothed_at_half(weighted, sigma, smooth)
    return out


def _smoothed_at_half(weighted: Float32, sigma: float, out: Float32) -> None:
    """Opponents (h, w, 3) of weighted colours smoothed by `sigma` pixels, computed at half the resolution."""
    height, width = weighted.shape[:2]
    half = cv2.resize(weighted, ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA)
    # Halving and interpolation smooth as well, together with about this variance.
    log = _smoothed(np.asarray(half, dtype=np.float32), 0.5 * float(np.sqrt(sigma * sigma - 0.75)))
    small = np.empty((*log.shape[1:], 3), np.float32)
    _opponents_of_logs(log, small)
    cv2.resize(small, (width, height), dst=out, interpolation=cv2.INTER_LINEAR)


def _smoothed(weighted: Float32, sigma: float) -> Float32:
    """Logarithms (3, h, w) of the weighted mean of colours (h, w, 4) over `sigma` pixels, plus DARKEST."""
    smooth = np.asarray(cv2.GaussianBlur(weighted, (0, 0), sigma), dtype=np.float32)
    log = np.empty((3, *weighted.shape[:2]), np.float32)
    _normalised(smooth, log)
    np.log(log, out=log)
    return log


@jit_dividing
def _weighted(color: UInt8, weight: Float32) -> Float32:
    """Linear values of colours (h, w, 3) times weights (h, w), and the weights behind them: (h, w, 4)."""
    height, width = weight.shape
    out = np.empty((height, width, 4), np.float32)
    for v in range(height):
        for u in range(width):
            w = weight[v, u]
            out[v, u, 0], out[v, u, 1] = LINEAR[color[v, u, 0]] * w, LINEAR[color[v, u, 1]] * w
            out[v, u, 2], out[v, u, 3] = LINEAR[color[v, u, 2]] * w, w
    return out


@jit_dividing
def _normalised(smooth: Float32, out: Float32) -> None:
    """Weighted colours (h, w, 4) divided by their weight, plus DARKEST, as planes (3, h, w)."""
    darkest = np.float32(DARKEST)
    for v in range(smooth.shape[0]):
        for u in range(smooth.shape[1]):
            share = np.float32(1.0) / smooth[v, u, 3]
            for q in range(3):
                out[q, v, u] = smooth[v, u, q] * share + darkest


@jit_dividing
def _opponents_of_logs(log: Float32, out: Float32) -> None:
    """Opponents (h, w, 3) of logarithms (3, h, w), as in `colorpair.opponents`."""
    scale, half, third = np.float32(SCALE), np.float32(0.5 * SCALE), np.float32(SCALE / 3.0)
    for v in range(log.shape[1]):
        for u in range(log.shape[2]):
            red, green, blue = log[0, v, u], log[1, v, u], log[2, v, u]
            out[v, u, 0] = (red + green + blue) * third
            out[v, u, 1] = (red - green) * scale
            out[v, u, 2] = (red + green) * half - blue * scale


def _believed_points(crop: Crop, belief: Float32) -> tuple[Float64, Float64]:
    """Camera-frame points (N, 3) of pixels with belief, and their belief (N,), in an order that depends only
    on their number."""
    inner = cv2.erode((belief > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if np.count_nonzero(inner) <= 120:
        inner = belief > 0
    points, rows, columns = sampled_points(crop, inner, MASK_POINTS)
    return points, belief[rows, columns].astype(np.float64)


def sampled_points(crop: Crop, mask: Bool, count: int) -> tuple[Float64, Int64, Int64]:
    """At most `count` camera-frame points (N, 3) of the pixels with depth of a mask (h, w) of the crop, in
    random order, with their rows (N,) and columns (N,)."""
    flat = np.flatnonzero(mask & (crop.depth > 0))
    chosen = np.random.default_rng(len(flat)).choice(flat, min(count, len(flat)), replace=False)
    rows, columns = np.divmod(chosen, crop.depth.shape[1])
    points = crop.camera.backproject(np.stack([columns, rows], -1), crop.depth[rows, columns])
    return points, rows, columns
