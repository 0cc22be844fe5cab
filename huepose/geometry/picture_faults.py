"""What a picture lacks as such: light, colour, depth, depth in the right unit, a likely camera matrix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry.arrays import Bool, Float32, UInt8
from huepose.geometry.camera import Camera, depth_noise_m
from huepose.geometry.frame import RgbdFrame
from huepose.support.words import rounded

DARK = 24
"""Of 255: where eight bits have fewer than a tenth of their steps, noise of two steps hides colours."""

GREY = 2
"""Of 255: channels that differ by no more say no colour: it is the noise of a camera's conversion."""

GLARE = 250
"""Of 255: where every channel is as bright a lamp outshines the colours."""

LEAST_LIT = 0.1
"""Share of a picture that is neither dark nor glare from which it can be told to have no colours. Of 335 real
pictures of seven sets channels are alike in at most 27 % of that."""

NO_COLOUR = (
    "The picture has no colour (red, green and blue are alike): objects are told by their colours. Is the "
    "camera's colour stream read?"
)

IF_IN_PLAIN_VIEW = "If it is in plain view, look at the depth scale, and at fx and fy."
"""What to do about an object that is not found, or never surely, where nothing is known to be wrong."""

LEAST_DEPTH = 0.01
"""A smaller share of readings is no depth picture: specks, in which no surface of any object is."""

NEARLY_ALL = 0.99
"""Of a picture that is dark or grey: a lamp or a stamp of the time may be in it."""

NEAREST_SHARE = 0.05
"""Share of the readings that are ignored as specks when the nearest depth of a frame is taken."""

LARGEST_ERROR = 0.25
"""Depth error over the object's diameter above which its shape cannot be seen."""

NEVER_NEARER_M = 0.1
"""Nearest distance that any depth camera measures, metres."""

OFF_MIDDLE = 0.05
"""Largest usual distance of the principal point from the picture's middle, in picture widths, either way:
lenses sit within 3 % of their sensor's middle."""

OBLONG = 0.03
"""Largest usual difference of fx and fy: pixels are square."""

_EVERY_ROW = 16

_EVERY = 4
"""Each such pixel of a row and column is looked at: enough for shares of a whole picture."""

_ONE_OF = 17
"""So much of depth is looked at: readings may be missing in every second row or column, or third, and no such
lattice is one of this number."""


def dark(color: UInt8) -> Bool:
    """Pixels (...) of colours (..., 3) that are too dark to tell which."""
    return _brightest(color) < DARK


def all_dark(color: UInt8) -> bool:
    """Whether a picture (H, W, 3) is black.

    >>> picture = np.full((48, 64, 3), 120, np.uint8)
    >>> all_dark(picture), all_dark(picture // 10)
    (False, True)
    """
    return float(dark(color[::_EVERY, ::_EVERY]).mean()) >= NEARLY_ALL


def all_grey(color: UInt8) -> bool:
    """Whether a picture (H, W, 3) has no colours, as of a camera that measures brightness alone. What is dark
    or glare says nothing of it.

    >>> picture = np.full((48, 64, 3), 120, np.uint8)
    >>> all_grey(picture), all_grey(picture + np.uint8([0, 5, 0])), all_grey(picture // 10)
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
    """Whether two pictures are the same; a few of their rows tell nearly always that they are not.

    >>> picture = np.full((48, 64, 3), 120, np.uint8)
    >>> same(picture, picture.copy()), same(picture, picture + 1)
    (True, False)
    """
    return np.array_equal(one[::_EVERY_ROW], other[::_EVERY_ROW]) and np.array_equal(one, other)


def some_of(depth: Float32) -> Float32:
    """Values (N,) of a depth picture (H, W): enough of them for shares, in all rows and columns."""
    return np.asarray(depth.reshape(-1)[::_ONE_OF])


def depth_share(depth: Float32, farthest_m: float = np.inf) -> float:
    """Share of a depth picture (H, W) with a reading; less than `LEAST_DEPTH` is none.

    >>> depth_share(np.full((48, 64), np.nan, np.float32))
    0.0
    """
    return float(readings(some_of(depth), farthest_m).mean())


def camera_doubted(camera: Camera) -> str | None:
    """A question about a camera matrix that no whole picture of a usual camera has; None where there is none.

    >>> camera_doubted(Camera(600.0, 600.0, 318.0, 243.0, 640, 480)) is None
    True
    """
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    width, height = camera.width, camera.height
    aside = max(abs(cx - 0.5 * (width - 1)), abs(cy - 0.5 * (height - 1)))
    if aside > OFF_MIDDLE * width:
        return (
            f"The camera matrix has cx {cx:.0f}, cy {cy:.0f}, {aside:.0f} px from the middle of {width} x "
            f"{height} pixels: is the picture a part of a larger one? Else every pose is off to that side."
        )
    if abs(np.log(fx / fy)) > OBLONG:
        return (
            f"The camera matrix has fx {fx:.0f} and fy {fy:.0f}: was the picture stretched? Else one of the "
            "two is wrong, and every pose is off."
        )
    return None


def depth_doubted(frame: RgbdFrame) -> str | None:
    """A question about depth that is nearer than most cameras measure, for a frame in which nothing is found:
    some do measure there. None where there is none."""
    seen = _readings_of(frame)
    if not len(seen) or float(np.quantile(seen, NEAREST_SHARE)) >= NEVER_NEARER_M:
        return None
    median_m = float(np.median(seen))
    return f"Half of all depth is nearer than {rounded(median_m)} m: is that so, or is the depth scale wrong?"


def bad_picture(frame: RgbdFrame, diameter_m: float) -> str | None:
    """What is wrong with a frame in which an object of that diameter is sought; None where nothing is."""
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
            f"All depth is {rounded(nearest)} m away or farther, where readings err by "
            f"{rounded(100 * error_m)} cm and the object has no shape: is the depth scale right?"
        )
    if median < NEVER_NEARER_M:
        return (
            f"Half of all depth is nearer than {rounded(median)} m, where nothing measures: is the depth "
            "scale right?"
        )
    if frame.camera.fx * diameter_m > max(frame.camera.width, frame.camera.height) * farthest:
        return (
            f"All depth is nearer than {rounded(farthest)} m, where an object of {100 * diameter_m:.0f} cm "
            "is larger than the picture: is the depth scale right?"
        )
    if all_dark(frame.color):
        return "The picture is black: is the lens covered, or the light off?"
    if all_grey(frame.color):
        return NO_COLOUR
    return None


def why_nothing_is_found(frame: RgbdFrame, diameters_m: Sequence[float]) -> str | None:
    """What is wrong, or may be, with a frame in which none of the objects of these diameters is found; None
    where nothing is, and where some of them could be seen in it."""
    if not diameters_m:
        return None
    smallest, largest = bad_picture(frame, min(diameters_m)), bad_picture(frame, max(diameters_m))
    return smallest if smallest and largest else depth_doubted(frame)


def _brightest(color: UInt8) -> UInt8:
    """The brightest channel (...) of colours (..., 3), in a tenth of the time of a reduction over three."""
    return np.maximum(np.maximum(color[..., 0], color[..., 1]), color[..., 2])


def _readings_of(frame: RgbdFrame) -> Float32:
    """The depth readings of a frame (N,), metres: enough of them for shares."""
    depth = some_of(frame.depth)
    return depth[readings(depth)]
