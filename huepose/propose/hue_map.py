"""Where in a region are the hues of an object? Histogram back-projection in the light that is known or not
(Swain and Ballard 1991: the ratio of two histograms)."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.judge.region import ModelArrays, RegionArrays

BINS, WIDTH = 40, 6.0
"""Bins of red-green and yellow-blue each, and their width in opponent units, about grey."""

LIGHT_BINS, ANY_LIGHT_BINS = 1.0, 2.5
"""Blur of the object's histogram (bins): shading and noise in a known light, and what lights do."""

FLOOR = 2e-4
"""Density of a hue that neither shows."""

MOST = 2.0
"""A pixel says no more than this, as a natural logarithm."""


def hue_map(model: ModelArrays, region: RegionArrays) -> Float32:
    """How much likelier each pixel's hue is the object's than the region's (h, w), a natural logarithm; 0
    where the pixel is saturated or has no depth."""
    shift = region.light[1:] if region.lit else np.zeros(2)
    own = _histogram(_bins(model.colors[1][:, 1:] + shift.astype(np.float32)))
    own = _blurred(own, LIGHT_BINS if region.lit else ANY_LIGHT_BINS)
    hues = region.colors[1, ..., 1:]
    speaks = (region.depth > 0) & ~region.saturated
    place = _bins(hues)
    if not speaks.any():
        return np.zeros(region.depth.shape, np.float32)
    around = _blurred(_histogram(place[speaks]), 1.0)
    ratio = np.clip(np.log((own + FLOOR) / (around + FLOOR)), -MOST, MOST).astype(np.float32)
    return np.where(speaks, ratio.ravel()[place], np.float32(0.0))


def averaged(values: Float32, side_px: float) -> Float32:
    """Mean of a map (h, w) over squares of that side."""
    side = max(1, round(side_px))
    return np.asarray(cv2.blur(values, (side, side)), np.float32)


def _bins(hues: Float32) -> np.ndarray:
    """Number of the bin of each hue (..., 2)."""
    cells = np.clip(np.rint(hues / np.float32(WIDTH)), -(BINS // 2), BINS - 1 - BINS // 2)
    number: np.ndarray = cells[..., 0] * BINS + cells[..., 1] + (BINS // 2) * (BINS + 1)
    return number.astype(np.int32)


def _histogram(bins: np.ndarray) -> Float64:
    """Share of hues, by the numbers of their bins, in each bin (BINS, BINS)."""
    counts = np.bincount(bins.ravel(), minlength=BINS * BINS).astype(np.float64)
    return np.asarray((counts / max(counts.sum(), 1.0)).reshape(BINS, BINS))


def _blurred(histogram: Float64, sigma: float) -> Float64:
    return np.asarray(cv2.GaussianBlur(histogram, (0, 0), sigma), np.float64)
