"""Take a veil of light off a picture: flare, a dirty lens, mist.

A veil adds the same light to all of a picture, so nothing in it is darker than the veil, and there is hardly
a picture in which nothing is dark (dark-object subtraction: Chavez, 1988; He et al., CVPR 2009). In
logarithms it takes the contrast from what is dark: a thing and the shadow beside it have one colour, and seem
to be one surface.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from huepose.colorpair.opponents import DARKEST, LINEAR
from huepose.geometry.arrays import UInt8
from huepose.geometry.frame import RgbdFrame

DARK = 0.001
"""Share of a picture that is at most as light as its veil: more than noise, and no more than a dark thing."""


def unveiled(frame: RgbdFrame) -> RgbdFrame:
    """The frame without the light that `veil` measures; itself where that is no more than colours take for
    noise (`opponents.DARKEST`)."""
    light = veil(frame.color)
    if light <= DARKEST:
        return frame
    linear = np.maximum(LINEAR - np.float32(light), 0.0) / np.float32(1.0 - light)
    table = np.searchsorted(0.5 * (LINEAR[1:] + LINEAR[:-1]), linear).astype(np.uint8)
    return replace(frame, color=np.asarray(cv2.LUT(frame.color, table), np.uint8))


def veil(color: UInt8) -> float:
    """The light, 0..1 linear, that is added to all of a picture (h, w, 3): the weakest channel of its darkest
    pixels. A picture with a black border, as rectification leaves it, has none.

    >>> picture = np.full((20, 30, 3), 150, np.uint8)
    >>> picture[4:8, 4:8] = 80, 60, 90
    >>> veil(picture) == float(LINEAR[60])
    True
    """
    some = color[::2, ::2]
    weakest = cv2.min(cv2.min(some[..., 0], some[..., 1]), some[..., 2])
    count = np.bincount(weakest.ravel(), minlength=256)
    return float(LINEAR[int(np.searchsorted(np.cumsum(count), DARK * weakest.size))])
