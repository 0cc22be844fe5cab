"""Estimate a large offset between depth and colour images from all of a frame, without any known object.

Where an object ends in front of its background, depth has a step and colour has an edge in the same
direction. Steps and edges are correlated for every shift of one over the other.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from huepose.estimation.depth_offset import DepthOffset
from huepose.estimation.outlines import smoothed
from huepose.geometry.arrays import NORMAL_MAD, Bool, Float32, Float64
from huepose.geometry.frame import RgbdFrame

Complex = NDArray[np.complexfloating]

WIDTH_PX = 640
"""Images are first reduced to about this width: the time of a transform grows with the number of pixels."""

REACH_PX = 64
"""Largest shift in each direction, in the reduced image: a depth camera 5 cm beside the colour camera is 40
px off at 0.8 m."""

FITS_PX = 8
"""Smaller shifts are not reported: they are usual in published data, or come from objects with steps at one
side only."""

CLEAR_SIGMAS = 3.0
"""Least lead of the best shift over all usual shifts, in standard deviations over all shifts. None of 87
unchanged frames of twelve sets, real and rendered, has it, and none of 150 frames of nine sequences."""

FEWEST = 60
"""Least number of pixels at depth steps."""

STEP = 0.03
"""Least depth step from an object to its background: metres, and beyond 1 m a share of the distance."""

_DISTINCT = 0.9
"""Image edges above this quantile of their strength all count alike."""


def frame_offset(frame: RgbdFrame) -> DepthOffset | None:
    """The offset of a frame's colours from its depth if it is clearly more than FITS_PX, and at most REACH_PX
    in each direction (in an image WIDTH_PX wide); None if it is not, or if the frame has too few depth
    steps."""
    every = max(1, round(frame.camera.width / WIDTH_PX))
    at = steps_of_depth(np.ascontiguousarray(frame.depth[::every, ::every]))
    if np.count_nonzero(at) < FEWEST:
        return None
    color = frame.color
    if every > 1:
        color = np.asarray(cv2.resize(color, at.shape[::-1], interpolation=cv2.INTER_AREA), np.uint8)
    fit = _correlated(_steps(at), _edges(smoothed(color)))
    middle = float(np.median(fit))
    spread = NORMAL_MAD * float(np.median(np.abs(fit - middle)))
    down, right = np.unravel_index(int(np.argmax(fit)), fit.shape)
    usual = slice(REACH_PX - FITS_PX, REACH_PX + FITS_PX + 1)
    lead = float(fit.max() - fit[usual, usual].max()) / max(spread, 1e-9)
    if lead < CLEAR_SIGMAS:
        return None
    shift = every * (np.array([right, down], np.float64) - REACH_PX)
    return DepthOffset(float(shift[0]), float(shift[1]), lead, int(np.count_nonzero(at)))


def steps_of_depth(depth: Float32) -> Bool:
    """The pixels (H, W) on objects next to something clearly behind them."""
    read = depth > 0.0
    near = cv2.erode(np.where(read, depth, np.float32(np.inf)), np.ones((5, 5)))
    far = cv2.dilate(np.where(read, depth, np.float32(0.0)), np.ones((5, 5)))
    with np.errstate(invalid="ignore"):
        step = np.where(np.isfinite(near), far - near, np.float32(0.0))
        before, behind = depth < near + 0.3 * step, depth > near + 0.7 * step
    there = read & (step > STEP * np.maximum(1.0, np.where(np.isfinite(near), near, 0.0)))
    beside = cv2.dilate((there & behind).astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.asarray(there & before & (beside > 0))


def _edges(picture: Float32) -> Complex:
    """The directions across the edges of an image (H, W, C), of length 1 where they are distinct."""
    across = _across(picture, blur_px=0.0)
    length = np.abs(across)
    return np.asarray(across / np.maximum(length, max(float(np.quantile(length, _DISTINCT)), 1e-9)))


def _steps(at: Bool) -> Complex:
    """The directions across the line that the depth steps (H, W) form, of length 1 at these, else 0."""
    line = np.asarray(cv2.GaussianBlur(at.astype(np.float32), (0, 0), 2.0), np.float32)
    across = _across(line[..., None], blur_px=3.0)
    return np.where(at, across / np.maximum(np.abs(across), 1e-9), 0.0)


def _across(picture: Float32, blur_px: float) -> Complex:
    """The direction in which an image (H, W, C) changes most, as complex numbers (H, W) of twice its angle,
    so that opposite directions are equal."""
    x, y = (cv2.Sobel(picture, cv2.CV_32F, *axes).reshape(picture.shape) for axes in ((1, 0), (0, 1)))
    xx, xy, yy = (x * x).sum(-1), (x * y).sum(-1), (y * y).sum(-1)
    if blur_px:
        xx, xy, yy = (cv2.GaussianBlur(one, (0, 0), blur_px) for one in (xx, xy, yy))
    return np.asarray((xx - yy) + 2j * xy)


def _correlated(steps: Complex, edges: Complex) -> Float64:
    """How well steps (H, W) fit edges (H, W) that are shifted by (down, right): 2 REACH_PX + 1 shifts along
    each axis."""
    size = [cv2.getOptimalDFTSize(side + REACH_PX) for side in steps.shape]
    product = np.conj(np.fft.fft2(steps, size)) * np.fft.fft2(edges, size)
    fit = np.roll(np.fft.ifft2(product).real, (REACH_PX, REACH_PX), axis=(0, 1))
    return np.asarray(fit[: 2 * REACH_PX + 1, : 2 * REACH_PX + 1])
