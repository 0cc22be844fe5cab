"""Looks: how much a frame counts beside the one before it.

Frames in quick succession show the same again, with the same errors. So all averages and counts over frames
are over looks, and a tracker decides no faster with a camera of 90 Hz. A late frame is one look, however
late."""

from __future__ import annotations

LOOK_S = 0.033
"""Frames at least this many seconds apart are one look each. At 30 Hz, at which all shares and numbers of
looks were chosen, each frame is one."""


def looks(seconds: float) -> float:
    """How many looks, at most one, a frame counts that comes `seconds` after the last one.

    >>> looks(0.2), looks(1 / 30), round(looks(1 / 90), 2)
    (1.0, 1.0, 0.34)
    """
    return min(max(seconds, 0.0) / LOOK_S, 1.0)


def enough(counted: float, wanted: int) -> bool:
    """Whether the wanted number of looks in a row was reached, with a tolerance of half a look: frames do not
    come to the millisecond.

    >>> enough(sum(looks(seconds) for seconds in (0.031, 0.034, 0.029, 0.036, 0.033)), 5)
    True
    """
    return counted >= wanted - 0.5


def share(of_a_look: float, seconds: float) -> float:
    """Weight, in a running mean, of a frame that comes `seconds` after the last one; of_a_look: the weight of
    a whole look.

    >>> three = 1.0 - (1.0 - share(0.15, 0.011)) ** 3
    >>> round(share(0.15, 0.2), 3), round(three, 3)
    (0.15, 0.15)
    """
    count = looks(seconds)
    return of_a_look if count == 1.0 else 1.0 - (1.0 - of_a_look) ** count
