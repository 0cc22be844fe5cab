"""Whether poses of a hand and of an object belong together at all, and what they may have been taken for.

Poses of an object err by millimetres and by a degree or two. Where the best answer leaves far more than that
at the usual pose, it is no error of poses: the numbers mean something else than was taken. What they may mean
instead is tried, and what then fits is named.
"""

from __future__ import annotations

from itertools import combinations
from typing import Literal

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.hand_eye import HandEye, lever, solve
from huepose.support.errors import InputError

MOST_SHIFT_M, MOST_TURN_RAD = 0.02, np.radians(3.0)
MOST_SHIFT = 0.02
"""Of the distance at which the object is seen: depth errs by a share of it."""

FARTHEST_M = 10.0
"""No depth camera measures poses of an object that is farther away: these are no metres."""

WIDEST = np.tan(np.radians(60.0))
"""Of half the field of view: the widest depth cameras see 120 degrees (Azure Kinect)."""

UNSEEN = 0.1
"""Share of poses that may lie where no camera sees: wild ones."""

Meaning = Literal["millimetres", "object in millimetres", "quaternion order", "camera"]
"""Positions of the hand, or of the object, that are no metres; quaternions of the hand with w first; a camera
that is mounted the other way, or poses of the base in the hand, which are the same."""
_MEANINGS: tuple[Meaning, ...] = ("millimetres", "object in millimetres", "quaternion order", "camera")


def measured(hand: Float64, fixed: bool) -> Float64:
    """A (N, 4, 4) of `hand_eye.solve` of T_base_hand (N, 4, 4), for a fixed camera or one on the hand."""
    return np.array([se3.inverse(T) for T in hand]) if fixed else np.asarray(hand, np.float64)


def fits(B: Float64, found: HandEye) -> bool:
    """Whether what is left of the usual (median) measurement may be the error of its poses; B (N, 4, 4) and
    the answer of `hand_eye.solve`."""
    most_m = max(MOST_SHIFT_M, MOST_SHIFT * lever(B))
    if float(np.median(np.linalg.norm(B[:, :3, 3], axis=1))) > FARTHEST_M:
        return False
    return bool(np.median(found.shift_m) <= most_m and np.median(found.turn_rad) <= MOST_TURN_RAD)


def exchanged(hand: Float64, B: Float64) -> bool:
    """Whether T_base_hand (N, 4, 4) and B (N, 4, 4) were taken for each other: B lies where no camera sees an
    object, and the hand where one might. Poses that are exchanged fit as well, to another mount."""
    return _unseen(B) > UNSEEN and _unseen(hand) == 0.0


def _unseen(T: Float64) -> float:
    """Share of the poses (N, 4, 4) that lie behind a camera, or beside all that the widest sees."""
    return float(np.mean(np.abs(T[:, :2, 3]).max(1) > WIDEST * T[:, 2, 3]))


def meant(hand: Float64, B: Float64, fixed: bool) -> tuple[Meaning, ...]:
    """What else the poses of the hand (N, 4, 4), taken as T_base_hand, may mean: the fewest changes with
    which they fit B (N, 4, 4), empty where none do. For poses that do not fit as they are."""
    for count in range(1, len(_MEANINGS) + 1):
        for changes in combinations(_MEANINGS, count):
            A = measured(_changed(hand, changes), fixed != ("camera" in changes))
            seen = np.array(B, np.float64)
            if "object in millimetres" in changes:
                seen[:, :3, 3] *= 1e-3
            try:
                if fits(seen, solve(A, seen)):
                    return changes
            except InputError:  # turns about one axis alone: it is not that
                continue
    return ()


def _changed(hand: Float64, changes: tuple[Meaning, ...]) -> Float64:
    hand = np.array(hand, np.float64)
    if "millimetres" in changes:
        hand[:, :3, 3] *= 1e-3
    if "quaternion order" in changes:
        for T in hand:
            w, x, y, z = se3.quaternion_from_rotation(T[:3, :3])  # read as x, y, z, w
            T[:3, :3] = se3.rotation_from_quaternion(np.array([x, y, z, w]))
    return hand
