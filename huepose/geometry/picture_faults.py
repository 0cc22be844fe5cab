"""What a picture lacks as such: light, colour, depth. Whoever says that it does asks here."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool, Float32, UInt8

DARK = 24
"""Of 255: where eight bits have fewer than a tenth of their steps, noise of two steps hides colours."""

GREY = 2
"""Of 255: channels that differ by no more say no colour: it is the noise of a camera's conversion."""

LEAST_DEPTH = 0.01
"""A smaller share of readings is no depth picture: specks, in which no surface of any object is."""

NEARLY_ALL = 0.99
"""Of a picture that is dark or grey: a lamp or a stamp of the time may be in it."""

_EVERY = 4
"""Each such pixel of a row and column is looked at: enough for shares of a whole picture."""


def dark(color: UInt8) -> Bool:
    """Pixels (...) of colours (..., 3) that are too dark to tell which."""
    return np.asarray(color.max(-1) < DARK)


def all_dark(color: UInt8) -> bool:
    """Whether a picture (H, W, 3) is black.

    >>> picture = np.full((48, 64, 3), 120, np.uint8)
    >>> all_dark(picture), all_dark(picture // 10)
    (False, True)
    """
    return float(dark(color[::_EVERY, ::_EVERY]).mean()) >= NEARLY_ALL


def all_grey(color: UInt8) -> bool:
    """Whether a picture (H, W, 3) has no colours, as of a camera that measures brightness alone."""
    return float((np.ptp(color[::_EVERY, ::_EVERY], axis=2) <= GREY).mean()) >= NEARLY_ALL


def readings(depth: Float32, farthest_m: float = np.inf) -> Bool:
    """Pixels of depth (metres) with a reading that is nearer than `farthest_m`."""
    return np.asarray((depth > 0.0) & (depth < farthest_m))


def depth_share(depth: Float32, farthest_m: float = np.inf) -> float:
    """Share of a depth picture (H, W) with a reading; less than `LEAST_DEPTH` is none.

    >>> depth_share(np.full((48, 64), np.nan, np.float32))
    0.0
    """
    return float(readings(depth[::_EVERY, ::_EVERY], farthest_m).mean())
