"""Estimate a large offset between depth and colour images from all of a frame, without any known object.

Where a thing ends before its background, depth has a step and colours have an edge in the same direction.
How well these lie on one another is asked for every shift of the one over the other.
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
"""Pictures are made about so small first: a transform takes as long as there are pixels."""

REACH_PX = 64
"""Largest shift either way, in such a picture: a depth camera 5 cm beside the colour camera is 40 px off at
0.8 m."""

FITS_PX = 8
"""Smaller shifts are usual in published data, or are of what has steps at one side only."""

CLEAR_SIGMAS = 3.0
"""Least lead of the best shift over all that are usual, in standard deviations over all shifts. None of 87
frames of twelve sets, real and drawn, has it as it is, and none of 150 of nine films."""

FEWEST = 60
"""Least number of pixels at steps of depth."""

STEP = 0.03
"""Least step of depth from a thing to what is behind it, metres and share of the distance."""

_DISTINCT = 0.9
"""Quantile of the edges of a picture over which they are all equally strong."""


def frame_offset(frame: RgbdFrame) -> DepthOffset | None:
    """How the image's colours lie to its depth where they plainly lie elsewhere, by more than FITS_PX and at
    most REACH_PX either way (of a picture WIDTH_PX wide); None where they do not, or where too little of the
    frame says it."""
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
    """The pixels (H, W) of things right beside what is plainly behind them."""
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
    """The directions across the edges of a picture (H, W, C), of length 1 where they are distinct."""
    across = _across(picture, blur_px=0.0)
    length = np.abs(across)
    return np.asarray(across / np.maximum(length, max(float(np.quantile(length, _DISTINCT)), 1e-9)))


def _steps(at: Bool) -> Complex:
    """The directions across the line that the steps of depth (H, W) form, of length 1 at these, else 0."""
    line = np.asarray(cv2.GaussianBlur(at.astype(np.float32), (0, 0), 2.0), np.float32)
    across = _across(line[..., None], blur_px=3.0)
    return np.where(at, across / np.maximum(np.abs(across), 1e-9), 0.0)


def _across(picture: Float32, blur_px: float) -> Complex:
    """The direction in which a picture (H, W, C) changes most, as complex numbers (H, W) of twice its angle:
    light beside dark is as dark beside light."""
    x, y = (cv2.Sobel(picture, cv2.CV_32F, *axes).reshape(picture.shape) for axes in ((1, 0), (0, 1)))
    xx, xy, yy = (x * x).sum(-1), (x * y).sum(-1), (y * y).sum(-1)
    if blur_px:
        xx, xy, yy = (cv2.GaussianBlur(one, (0, 0), blur_px) for one in (xx, xy, yy))
    return np.asarray((xx - yy) + 2j * xy)


def _correlated(steps: Complex, edges: Complex) -> Float64:
    """How well steps (H, W) fit edges (H, W) that lie (down, right) of them, (2 REACH_PX + 1,) each way."""
    size = [cv2.getOptimalDFTSize(side + REACH_PX) for side in steps.shape]
    product = np.conj(np.fft.fft2(steps, size)) * np.fft.fft2(edges, size)
    fit = np.roll(np.fft.ifft2(product).real, (REACH_PX, REACH_PX), axis=(0, 1))
    return np.asarray(fit[: 2 * REACH_PX + 1, : 2 * REACH_PX + 1])
