"""Moments in which something tempts a tracker to believe what is no longer so.

What is feared most of a tracker is a pose it is sure of and that is wrong. So here the object is swapped or
taken away behind a board, its look-alike stays in its place, the light goes out while it is covered, and the
camera swings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from huepose.geometry import Mesh, se3
from huepose.geometry.arrays import Float64
from huepose.scenes.shapes import demo_objects
from studies.hard_moments.scripts import (
    FRAMES,
    RATE_HZ,
    Script,
    carried,
    curtain,
    night,
    palm,
    printed_board,
    scripted,
    smooth,
)

AWAY_M = -2.0
"""Behind the camera."""

CHANGED = 75
"""Frame at which something changes behind what hides the object."""

CURTAIN_M = 0.26

OTHER_TEXTURE = 3
"""Seed of the textures of look-alikes: another picture, other colours, the same words in other places."""


def look_alike(name: str) -> Mesh:
    """The same shape in another texture."""
    return demo_objects(OTHER_TEXTURE)[name]


def _leaving(path: Float64, at: int) -> Float64:
    """The same path, and from a frame on away."""
    out = path.copy()
    out[at:, :3, 3] = [0.0, 0.0, AWAY_M]
    return out


def _coming(path: Float64, at: int) -> Float64:
    """Away, and from a frame on that path."""
    out = path.copy()
    out[:at, :3, 3] = [0.0, 0.0, AWAY_M]
    return out


def swapped() -> Script:
    """Behind a board the box is swapped for its look-alike, which lies as the box would."""
    path = carried(FRAMES)
    others = [(look_alike("tea_box"), _coming(path, CHANGED)), curtain(CURTAIN_M)]
    decoys = (("box", 1),)
    return scripted("swapped for a look-alike", "box", _leaving(path, CHANGED), others=others, decoys=decoys)


def can_swapped() -> Script:
    """Behind a board the can is swapped for one of another kind."""
    path = carried(FRAMES, 1.0)
    others = [(look_alike("soup_can"), _coming(path, CHANGED)), curtain(CURTAIN_M)]
    decoys = (("can", 1),)
    return scripted("a can for another can", "can", _leaving(path, CHANGED), others=others, decoys=decoys)


def taken() -> Script:
    """Behind a board the object is taken away; another board that stood close behind it stays."""
    path = carried(FRAMES)
    back = np.tile(np.eye(4), (FRAMES, 1, 1))
    back[:, :3, 3] = [0.0, 0.0, 0.78]
    others = [(printed_board(0.5, 0.4), back), curtain(CURTAIN_M)]
    return scripted("taken away behind a board", "bottle", _leaving(path, CHANGED), others=others)


def beside() -> Script:
    """A look-alike crosses before the box and stays where the box was; the box is carried out of the
    image."""
    path, other = carried(FRAMES), carried(FRAMES, 1.3, (0.0, 0.0, 0.5))
    out = smooth(FRAMES, 90, FRAMES + 20, 25)
    other[:, 0, 3] -= 0.4 * (1.0 - smooth(FRAMES, 60, FRAMES + 20, 25))
    path[:, 0, 3] += 0.5 * out
    decoys = (("box", 1),)
    return scripted("a look-alike takes its place", "box", path, others=[(look_alike("tea_box"), other)],
                    decoys=decoys)  # fmt: skip


def dark() -> Script:
    """The light changes while a hand hides four fifths of the object, and stays so."""
    path = carried(FRAMES)
    lights = night(range(CHANGED, FRAMES), (0.4, 0.3, 0.22))
    return scripted("light changes behind a hand", "box", path, others=[palm(path)], lights=lights)


def swung() -> Script:
    """The camera is swung to and fro at up to 100 degrees a second; the object stands."""
    t = np.arange(FRAMES) / RATE_HZ
    angle = 0.2 * smooth(FRAMES, 50, 110, 10) * np.sin(9.0 * (t - 50 / RATE_HZ))
    views = np.array(
        [se3.make(se3.rotation_exp(np.array([0.3 * a, a, 0.2 * a])), np.zeros(3)) for a in angle]
    )
    path = np.tile(carried(1)[0], (FRAMES, 1, 1))
    return scripted("camera swung", "can", path, views=views)


TRAPS: Mapping[str, Callable[[], Script]] = {
    f.__name__: f for f in (swapped, can_swapped, taken, beside, dark, swung)
}
