"""Opponents: colours in which light is an offset. They are logarithms of linear RGB as lightness, red against
green, yellow against blue.

A coloured light multiplies linear red, green and blue by three numbers (von Kries), which adds constants to
their logarithms; shading multiplies all three by one, which changes the lightness alone. So correlations of
the last two channels depend on neither light nor shading, and the effect of shading on the first can be
removed with the surface's normals.

A veil of light (flare, a dirty lens, mist) is no such factor: it adds the same light everywhere in an image.
In logarithms this removes the contrast of dark parts, so that an object and the shadow beside it have one
colour and seem to be one surface. Nothing is darker than the veil, and nearly every image has dark parts
(dark-object subtraction: Chavez, 1988; He et al., CVPR 2009). So the veil is measured and subtracted first.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from huepose.geometry.arrays import Float, Float32, UInt8
from huepose.geometry.frame import RgbdFrame

DARKEST = 0.015
"""Added to linear values (0..1) before the logarithm: darker than this is noise."""

SCALE = 25.0
"""Units per natural logarithm, so that numbers are about as large as those of CIELAB."""

VEILED = 0.001
"""Share of an image that is at most as bright as its veil: more than noise, and no more than a dark
object."""

LINEAR = np.where(
    np.arange(256) <= 0.04045 * 255,
    np.arange(256) / 255 / 12.92,
    ((np.arange(256) / 255 + 0.055) / 1.055) ** 2.4,
).astype(np.float32)
_BETWEEN = (LINEAR[1:] + LINEAR[:-1]) / 2.0
BYTES = np.searchsorted(_BETWEEN, np.linspace(0.0, 1.0, 1024) ** 2).astype(np.uint8)
"""The sRGB byte of a linear value, indexed by its square root in steps of 1/1023."""

LOGARITHMS = (np.log(LINEAR + np.float32(DARKEST)) * np.float32(SCALE)).astype(np.float32)
OPPONENTS = np.array([[1 / 3, 1 / 3, 1 / 3], [1, -1, 0], [0.5, 0.5, -1]], np.float32)
"""Lightness, red-green, yellow-blue of three logarithms."""


def opponents(linear: Float) -> Float32:
    """Lightness, red-green and yellow-blue (..., 3) float32 of linear RGB (..., 3).

    >>> grey, red_light = np.full((1, 3), 0.5, np.float32), np.array([[0.8, 0.4, 0.2]], np.float32)
    >>> bool(np.ptp(opponents(grey)[0, 1:]) == 0.0) and bool(opponents(grey * red_light)[0, 1] > 10)
    True
    """
    log = np.maximum(linear, 0.0).astype(np.float32, copy=False)
    # In place: fresh memory costs more than the arithmetic.
    log += np.float32(DARKEST)
    np.log(log, out=log)
    log *= np.float32(SCALE)
    return np.asarray(log @ OPPONENTS.T, dtype=np.float32)


def opponents_of_bytes(color: UInt8) -> Float32:
    """The same (..., 3) of sRGB bytes (..., 3), by a table: a fifth of the time.

    >>> color = np.array([[10, 130, 250]], np.uint8)
    >>> bool(np.allclose(opponents_of_bytes(color), opponents(LINEAR[color]), atol=1e-4))
    True
    """
    if not color.size:  # OpenCV converts no empty images
        return np.zeros(color.shape, np.float32)
    flat = np.ascontiguousarray(color).reshape(-1, color.shape[-2] if color.ndim > 2 else 1, 3)
    return np.asarray(cv2.transform(cv2.LUT(flat, LOGARITHMS), OPPONENTS), np.float32).reshape(color.shape)


def opponents_of_lab(lab: Float) -> Float32:
    """The same (..., 3) of CIELAB colours (..., 3), L 0..100."""
    if not lab.size:  # OpenCV converts no empty images
        return np.zeros(lab.shape, np.float32)
    flat = np.ascontiguousarray(lab, dtype=np.float32).reshape(1, -1, 3)
    linear = np.asarray(cv2.cvtColor(flat, cv2.COLOR_Lab2LRGB), dtype=np.float32)
    return opponents(np.clip(linear, 0.0, 1.0, out=linear)).reshape(lab.shape)


def unveiled(frame: RgbdFrame) -> RgbdFrame:
    """The frame without the light that `veil` measures; the same frame if that is no more than DARKEST, which
    counts as noise."""
    light = veil(frame.color)
    if light <= DARKEST or light >= 1.0:  # all white
        return frame
    linear = np.maximum(LINEAR - np.float32(light), 0.0) / np.float32(1.0 - light)
    table = np.searchsorted(_BETWEEN, linear).astype(np.uint8)
    return replace(frame, color=np.asarray(cv2.LUT(frame.color, table), np.uint8))


def veil(color: UInt8) -> float:
    """The light, 0..1 linear, that is added everywhere in an image (h, w, 3): the weakest channel of its
    darkest pixels. An image with a black border, as rectification leaves it, has none.

    >>> picture = np.full((20, 30, 3), 150, np.uint8)
    >>> picture[4:8, 4:8] = 80, 60, 90
    >>> veil(picture) == float(LINEAR[60])
    True
    """
    some = color[::2, ::2]
    weakest = cv2.min(cv2.min(some[..., 0], some[..., 1]), some[..., 2])
    count = np.bincount(weakest.ravel(), minlength=256)
    return float(LINEAR[int(np.searchsorted(np.cumsum(count), VEILED * weakest.size))])
