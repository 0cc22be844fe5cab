"""Whether poses of a hand and of an object fit together at all, and which wrong convention may be the cause.

Poses of an object have errors of millimetres and of a degree or two. If the median residual of the best
solution is far larger, the cause is not pose error: the numbers have other units or another convention than
assumed. Other meanings are tried, and those that fit are reported.
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
"""Share of the object's distance: the depth error grows with it."""

FARTHEST_M = 10.0
"""Objects are not farther than this from a depth camera; if poses say so, they are not in metres."""

WIDEST = np.tan(np.radians(60.0))
"""Tangent of half the field of view of the widest depth cameras: 120 degrees (Azure Kinect)."""

UNSEEN = 0.1
"""Share of poses that may lie outside the field of view of any camera: outliers."""

Meaning = Literal["millimetres", "object in millimetres", "quaternion order", "camera"]
"""Positions of the hand, or of the object, in millimetres; quaternions of the hand with w first; "camera":
the camera is mounted the other way, or the poses are of the base in the hand, which gives the same
equations."""
_MEANINGS: tuple[Meaning, ...] = ("millimetres", "object in millimetres", "quaternion order", "camera")


def measured(hand: Float64, fixed: bool) -> Float64:
    """A (N, 4, 4) of `hand_eye.solve` from T_base_hand (N, 4, 4), for a fixed camera or one on the hand."""
    return np.array([se3.inverse(T) for T in hand]) if fixed else np.asarray(hand, np.float64)


def fits(B: Float64, found: HandEye) -> bool:
    """Whether the median residual can be explained by errors of the poses. B (N, 4, 4) and the result of
    `hand_eye.solve`."""
    most_m = max(MOST_SHIFT_M, MOST_SHIFT * lever(B))
    if float(np.median(np.linalg.norm(B[:, :3, 3], axis=1))) > FARTHEST_M:
        return False
    return bool(np.median(found.shift_m) <= most_m and np.median(found.turn_rad) <= MOST_TURN_RAD)


def exchanged(hand: Float64, B: Float64) -> bool:
    """Whether T_base_hand (N, 4, 4) and B (N, 4, 4) were exchanged: B lies outside of any camera's view,
    and the hand does not. The residuals do not show it: exchanged poses fit as well, with another mount."""
    return _outside_view(B) > UNSEEN and _outside_view(hand) == 0.0


def _outside_view(T: Float64) -> float:
    """Share of the poses (N, 4, 4) that lie behind a camera or outside of the widest field of view."""
    return float(np.mean(np.abs(T[:, :2, 3]).max(1) > WIDEST * T[:, 2, 3]))


def meant(hand: Float64, B: Float64, fixed: bool) -> tuple[Meaning, ...]:
    """What else the poses of the hand (N, 4, 4), read as T_base_hand, may mean: the fewest changes with
    which they fit B (N, 4, 4); empty if no change helps. For poses that do not fit as they are."""
    for count in range(1, len(_MEANINGS) + 1):
        for changes in combinations(_MEANINGS, count):
            A = measured(_changed(hand, changes), fixed != ("camera" in changes))
            objects = np.array(B, np.float64)
            if "object in millimetres" in changes:
                objects[:, :3, 3] *= 1e-3
            try:
                if fits(objects, solve(A, objects)):
                    return changes
            except InputError:  # rotations about one axis only: not this meaning
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
