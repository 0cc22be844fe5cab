"""Did the colour of the light change from one image to the next? Poses are judged in a known light, so a
surface that suddenly has another colour could as well be another object."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import UInt8
from huepose.geometry.image_faults import DARK
from huepose.judge.region import SATURATED

LEAST = 0.1
"""Smallest change of red or blue relative to green, in logarithms. Daylight and a camera's white balance take
many images to change by as much."""

_EVERY = 16
"""Distance between compared pixels along each axis."""


def relit(before: UInt8, now: UInt8) -> bool:
    """Whether the light changed between two successive images (H, W, 3) of one camera: most pixels changed
    their colour by the same factors, whatever they show.

    >>> before = np.random.default_rng(0).integers(40, 160, (480, 640, 3)).astype(np.uint8)
    >>> warmer = (before * np.array([1.1, 1.0, 0.7])).astype(np.uint8)
    >>> relit(before, warmer), relit(before, before // 2), relit(before, before[::-1])
    (True, False, False)
    """
    if before.shape != now.shape:
        return False
    pictures = np.stack([one[::_EVERY, ::_EVERY] for one in (before, now)])
    known = ((pictures >= DARK) & (pictures < SATURATED)).all(axis=(0, 3))
    if 2 * np.count_nonzero(known) < known.size:
        return False
    logs = np.log(pictures[:, known].astype(np.float64))
    red_and_blue = logs[..., ::2] - logs[..., 1:2]
    change = red_and_blue[1] - red_and_blue[0]
    usual = np.median(change, axis=0)
    spread = np.median(np.abs(change - usual).max(axis=1))
    return bool(np.abs(usual).max() > max(LEAST, 2.0 * spread))
