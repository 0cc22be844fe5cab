"""Frames as looks: how much a frame adds to the one before it.

Frames that follow each other soon show the same again, with the same errors. So what is averaged or counted
over frames is averaged and counted over looks, and a tracker does not make up its mind in a third of the time
before a camera of 90 Hz. A frame that comes late is one look, however late."""

from __future__ import annotations

LOOK_S = 0.033
"""Frames at least so many seconds apart are looks of their own. At 30 Hz, at which all shares and numbers of
looks were chosen, each frame is one."""


def looks(seconds: float) -> float:
    """How many looks, at most one, a frame counts so many seconds after the last one.

    >>> looks(0.2), looks(1 / 30), round(looks(1 / 90), 2)
    (1.0, 1.0, 0.34)
    """
    return min(max(seconds, 0.0) / LOOK_S, 1.0)


def enough(counted: float, wanted: int) -> bool:
    """Whether so many looks were counted in a row, but for half a one: frames do not come to the millisecond.

    >>> enough(sum(looks(seconds) for seconds in (0.031, 0.034, 0.029, 0.036, 0.033)), 5)
    True
    """
    return counted >= wanted - 0.5


def share(of_a_look: float, seconds: float) -> float:
    """Weight in a running mean of a frame so many seconds after the last one, where that of a look is known.

    >>> three = 1.0 - (1.0 - share(0.15, 0.011)) ** 3
    >>> round(share(0.15, 0.2), 3), round(three, 3)
    (0.15, 0.15)
    """
    count = looks(seconds)
    return of_a_look if count == 1.0 else 1.0 - (1.0 - of_a_look) ** count
