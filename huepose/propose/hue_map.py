"""Map of how typical each pixel's hue is of an object: histogram back-projection (Swain and Ballard 1991),
the ratio of the object's hue histogram and the region's."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.judge.kernel_arrays import ModelArrays, RegionArrays

BINS, WIDTH = 40, 6.0
"""Histogram bins along red-green and along yellow-blue, and their width in opponent units; grey is in the
middle."""

BLUR_BINS, UNKNOWN_LIGHT_BLUR_BINS = 1.0, 2.5
"""Gaussian sigma on the object's histogram, in bins: for shading and noise if the light's colour is known,
and for its unknown tint if it is not."""

MIN_DENSITY = 2e-4
"""Added to both densities, so that hues in neither histogram get a ratio of 1."""

MAX_LOG_RATIO = 2.0
"""The logarithm of the ratio is clipped to this, so that no single pixel decides."""


def hue_map(model: ModelArrays, region: RegionArrays) -> Float32:
    """Log-likelihood ratio (h, w, natural logarithm) of each pixel's hue, object to whole region; 0 where
    the pixel is saturated or has no depth."""
    shift = region.light[1:] if region.lit else np.zeros(2)
    object_density = _histogram(_bins(model.colors[1][:, 1:] + shift.astype(np.float32)))
    object_density = _blurred(object_density, BLUR_BINS if region.lit else UNKNOWN_LIGHT_BLUR_BINS)
    hues = region.colors[1, ..., 1:]
    usable = (region.depth > 0) & ~region.saturated
    bins = _bins(hues)
    if not usable.any():
        return np.zeros(region.depth.shape, np.float32)
    region_density = _blurred(_histogram(bins[usable]), 1.0)
    ratio = np.clip(
        np.log((object_density + MIN_DENSITY) / (region_density + MIN_DENSITY)), -MAX_LOG_RATIO, MAX_LOG_RATIO
    ).astype(np.float32)
    return np.where(usable, ratio.ravel()[bins], np.float32(0.0))


def averaged(values: Float32, side_px: float) -> Float32:
    """Box filter: the mean of a map (h, w) over squares of this side in pixels."""
    side = max(1, round(side_px))
    return np.asarray(cv2.blur(values, (side, side)), np.float32)


def _bins(hues: Float32) -> np.ndarray:
    """Flat bin index (...) of each hue (..., 2)."""
    cells = np.clip(np.rint(hues / np.float32(WIDTH)), -(BINS // 2), BINS - 1 - BINS // 2)
    number: np.ndarray = cells[..., 0] * BINS + cells[..., 1] + (BINS // 2) * (BINS + 1)
    return number.astype(np.int32)


def _histogram(bins: np.ndarray) -> Float64:
    """Normalised histogram (BINS, BINS) of flat bin indices."""
    counts = np.bincount(bins.ravel(), minlength=BINS * BINS).astype(np.float64)
    return np.asarray((counts / max(counts.sum(), 1.0)).reshape(BINS, BINS))


def _blurred(histogram: Float64, sigma: float) -> Float64:
    return np.asarray(cv2.GaussianBlur(histogram, (0, 0), sigma), np.float64)
