"""Faults of a frame: no light, no colour, no depth, depth in a wrong unit, an unlikely camera matrix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry.arrays import Bool, Float32, UInt8
from huepose.geometry.camera import Camera, depth_noise_m
from huepose.geometry.frame import RgbdFrame
from huepose.support.words import rounded

DARK = 24
"""Of 255. Below, a channel has less than a tenth of its range, and noise of two steps hides colours."""

GREY = 2
"""Of 255. Channels that differ by no more have no colour: a camera's colour conversion has such noise."""

GLARE = 250
"""Of 255. A pixel whose channels are all as bright is glare: a lamp outshines the colours."""

LEAST_LIT = 0.1
"""Share of an image that must be neither dark nor glare before the image can count as grey. In 335 real
images of seven sets, at most 27 % of these pixels have equal channels."""

NO_COLOUR = (
    "The image has no colour (red, green and blue are equal), and objects are distinguished by their "
    "colours. Is the camera's colour stream read?"
)

IF_IN_PLAIN_VIEW = "If it is in plain view, look at the depth scale, and at fx and fy."
"""Advice for an object that is not found, or never with certainty, if no fault of the frame is known."""

LEAST_DEPTH = 0.01
"""A depth image with a smaller share of readings counts as empty: they are specks, not surfaces."""

NEARLY_ALL = 0.99
"""Share of an image from which it counts as dark or grey: a lamp or a printed time may be in it."""

NEAREST_SHARE = 0.05
"""Share of the nearest readings that are ignored as specks in the nearest depth of a frame."""

LARGEST_ERROR = 0.25
"""Depth error over the object's diameter, above which its shape cannot be measured."""

NEVER_NEARER_M = 0.1
"""Nearest distance that any depth camera measures, metres."""

OFF_MIDDLE = 0.05
"""Largest usual distance of the principal point from the image centre along either axis, in image widths:
lenses are within 3 % of the centre of their sensor."""

OBLONG = 0.03
"""Largest usual |ln(fx / fy)|: pixels are square."""

_EVERY_ROW = 16

_EVERY = 4
"""Every fourth pixel of every fourth row is read: enough for shares of a whole image."""

_ONE_OF = 17
"""One of 17 depth readings is read. Readings may be missing in every second or third row or column; 17 does
not share a period with such a pattern."""


def dark(color: UInt8) -> Bool:
    """Pixels (...) of colours (..., 3) that are too dark to show a colour."""
    return _brightest(color) < DARK


def all_dark(color: UInt8) -> bool:
    """Whether an image (H, W, 3) is black.

    >>> image = np.full((48, 64, 3), 120, np.uint8)
    >>> all_dark(image), all_dark(image // 10)
    (False, True)
    """
    return float(dark(color[::_EVERY, ::_EVERY]).mean()) >= NEARLY_ALL


def all_grey(color: UInt8) -> bool:
    """Whether an image (H, W, 3) has no colours, as from a monochrome camera. Pixels that are dark or glare
    do not count.

    >>> image = np.full((48, 64, 3), 120, np.uint8)
    >>> all_grey(image), all_grey(image + np.uint8([0, 5, 0])), all_grey(image // 10)
    (True, False, False)
    """
    some = color[::_EVERY, ::_EVERY]
    brightest, palest = _brightest(some), np.minimum(np.minimum(some[..., 0], some[..., 1]), some[..., 2])
    lit = (brightest >= DARK) & (palest < GLARE)
    if float(lit.mean()) < LEAST_LIT:
        return False
    return float((brightest - palest <= GREY)[lit].mean()) >= NEARLY_ALL


def readings(depth: Float32, farthest_m: float = np.inf) -> Bool:
    """Pixels of depth (metres) with a reading that is nearer than `farthest_m`."""
    return np.asarray((depth > 0.0) & (depth < farthest_m))


def same(one: UInt8 | Float32, other: UInt8 | Float32) -> bool:
    """Whether two images are the same. A few rows are compared first: they show nearly every difference.

    >>> image = np.full((48, 64, 3), 120, np.uint8)
    >>> same(image, image.copy()), same(image, image + 1)
    (True, False)
    """
    return np.array_equal(one[::_EVERY_ROW], other[::_EVERY_ROW]) and np.array_equal(one, other)


def some_of(depth: Float32) -> Float32:
    """Values (N,) of a depth image (H, W): enough for shares, from all rows and columns."""
    return np.asarray(depth.reshape(-1)[::_ONE_OF])


def depth_share(depth: Float32, farthest_m: float = np.inf) -> float:
    """Share of a depth image (H, W) with readings nearer than `farthest_m`; below `LEAST_DEPTH` it is empty.

    >>> depth_share(np.full((48, 64), np.nan, np.float32))
    0.0
    """
    return float(readings(some_of(depth), farthest_m).mean())


def camera_doubted(camera: Camera) -> str | None:
    """A question about a camera matrix that does not fit a whole image of a usual camera; None if it fits.

    >>> camera_doubted(Camera(600.0, 600.0, 318.0, 243.0, 640, 480)) is None
    True
    """
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    width, height = camera.width, camera.height
    aside = max(abs(cx - 0.5 * (width - 1)), abs(cy - 0.5 * (height - 1)))
    if aside > OFF_MIDDLE * width:
        return (
            f"The camera matrix has cx {cx:.0f}, cy {cy:.0f}, {aside:.0f} px from the centre of {width} x "
            f"{height} pixels: is the image a crop of a larger one? If not, every pose is off to that side."
        )
    if abs(np.log(fx / fy)) > OBLONG:
        return (
            f"The camera matrix has fx {fx:.0f} and fy {fy:.0f}: was the image stretched? If not, one of "
            "the two is wrong, and every pose is off."
        )
    return None


def depth_doubted(frame: RgbdFrame) -> str | None:
    """A question about depth that is nearer than most cameras measure, for a frame in which nothing is
    found. It is a question because some cameras measure there. None if depth is not so near."""
    seen = _readings_of(frame)
    if not len(seen) or float(np.quantile(seen, NEAREST_SHARE)) >= NEVER_NEARER_M:
        return None
    median_m = float(np.median(seen))
    nearer = f"Half of all depth is nearer than {rounded(median_m)} m"
    return f"{nearer}: is this right, or is the depth scale wrong?"


def bad_image(frame: RgbdFrame, diameter_m: float) -> str | None:
    """What is wrong with a frame for the search of an object of that diameter; None if nothing is."""
    if depth_share(frame.depth) < LEAST_DEPTH:
        return (
            f"The frame has no depth (under {100 * LEAST_DEPTH:.0f} % of its pixels have a reading): is the "
            "depth stream on, and the depth scale right?"
        )
    seen = _readings_of(frame)
    shares = [NEAREST_SHARE, 0.5, 1.0 - NEAREST_SHARE]
    nearest, median, farthest = (float(x) for x in np.quantile(seen, shares))
    error_m = depth_noise_m(nearest)
    if error_m > LARGEST_ERROR * diameter_m:
        return (
            f"All depth is {rounded(nearest)} m away or farther, where the depth error is "
            f"{rounded(100 * error_m)} cm and hides the object's shape: is the depth scale right?"
        )
    if median < NEVER_NEARER_M:
        return (
            f"Half of all depth is nearer than {rounded(median)} m, where no camera measures: is the "
            "depth scale right?"
        )
    if frame.camera.fx * diameter_m > max(frame.camera.width, frame.camera.height) * farthest:
        return (
            f"All depth is nearer than {rounded(farthest)} m, where an object of {100 * diameter_m:.0f} cm "
            "is larger than the image: is the depth scale right?"
        )
    if all_dark(frame.color):
        return "The image is black: is the lens covered, or the light off?"
    if all_grey(frame.color):
        return NO_COLOUR
    return None


def why_nothing_is_found(frame: RgbdFrame, diameters_m: Sequence[float]) -> str | None:
    """What is or may be wrong with a frame in which none of the objects of these diameters is found; None
    if nothing is, or if some of the objects could be found in it."""
    if not diameters_m:
        return None
    smallest, largest = bad_image(frame, min(diameters_m)), bad_image(frame, max(diameters_m))
    return smallest if smallest and largest else depth_doubted(frame)


def _brightest(color: UInt8) -> UInt8:
    """The brightest channel (...) of colours (..., 3), in a tenth of the time of `max` over the axis."""
    return np.maximum(np.maximum(color[..., 0], color[..., 1]), color[..., 2])


def _readings_of(frame: RgbdFrame) -> Float32:
    """Depth readings (N,) of a frame, metres: enough for shares."""
    depth = some_of(frame.depth)
    return depth[readings(depth)]
