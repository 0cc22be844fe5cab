"""What light, cameras and distance do to a picture, each by one number: for measuring what survives it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import linear_rgb
from huepose.geometry.arrays import Float, Float32, UInt8

Change = Callable[[UInt8, float], UInt8]


@dataclass(frozen=True)
class ChangeSeries:
    """A kind of change and the amounts at which it is measured; `neutral` is the amount that does nothing."""

    name: str
    unit: str
    amounts: tuple[float, ...]
    neutral: float
    apply: Change


def bytes_of(linear: Float) -> UInt8:
    """sRGB bytes of linear values, cut off at 0 and 1."""
    x = np.clip(linear, 0.0, 1.0)
    srgb = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * srgb), np.uint8)


def exposure(color: UInt8, stops: float) -> UInt8:
    """Twice the light for every stop; what is brighter than white is cut off."""
    return bytes_of(linear_rgb(color) * np.float32(2.0**stops))


def white_balance(color: UInt8, gain: float) -> UInt8:
    """Red times `gain`, blue divided by it, in linear light."""
    return bytes_of(linear_rgb(color) * np.array([gain, 1.0, 1.0 / gain], np.float32))


def gamma(color: UInt8, power: float) -> UInt8:
    """Values raised to a power, as a camera's tone curve does."""
    return np.asarray(np.rint(255 * (color / 255.0) ** power), np.uint8)


def shadow(color: UInt8, strength: float) -> UInt8:
    """The lower right half loses this share of its light, with a soft edge on the diagonal."""
    h, w = color.shape[:2]
    v, u = np.mgrid[0:h, 0:w]
    inside = 1.0 / (1.0 + np.exp(-((u - w / 2) + (v - h / 2)) / 4.0))
    return bytes_of(linear_rgb(color) * (1.0 - strength * inside)[..., None].astype(np.float32))


def noise(color: UInt8, sigma: float) -> UInt8:
    """Independent noise of each value, in steps of 255."""
    spread: Float32 = np.random.default_rng(0).normal(0.0, sigma, color.shape).astype(np.float32)
    return np.asarray(np.clip(np.rint(color + spread), 0, 255), np.uint8)


def blur(color: UInt8, sigma: float) -> UInt8:
    """A Gaussian of this many pixels."""
    return color if sigma <= 0 else np.asarray(cv2.GaussianBlur(color, (0, 0), sigma), np.uint8)


def same(color: UInt8, _: float) -> UInt8:
    """The picture as it is: distance changes how it is rendered, not what is done to it."""
    return color


SCALE = "scale"

SERIES: tuple[ChangeSeries, ...] = (
    ChangeSeries("exposure", "stops", (-2.0, -1.0, 0.0, 1.0, 2.0), 0.0, exposure),
    ChangeSeries(
        "white balance", "gain of red, 1/gain of blue", (0.6, 0.8, 1.0, 1.25, 1.6), 1.0, white_balance
    ),
    ChangeSeries("gamma", "power", (0.5, 0.7, 1.0, 1.4, 2.0), 1.0, gamma),
    ChangeSeries("shadow", "share of light lost", (0.0, 0.2, 0.4, 0.6, 0.8), 0.0, shadow),
    ChangeSeries("noise", "of 255", (0.0, 4.0, 8.0, 12.0, 16.0), 0.0, noise),
    ChangeSeries("blur", "pixels", (0.0, 0.5, 1.0, 1.5, 2.0), 0.0, blur),
    ChangeSeries(SCALE, "times as large", (0.5, 0.7, 1.0, 1.4, 2.0), 1.0, same),
)
