"""How sure it is that the pose that is followed was the right one to begin with.

What one frame shows cannot settle everything: a can whose texture repeats, a box seen on a blank side. So the
quality of the estimate that started a track stays with it, and doubt shrinks when perception agrees on its
own, or when the object has been carried to another viewpoint and its texture still agrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.judge.terms import Terms

NEW_VIEW = np.radians(25.0)
"""What is seen from a viewpoint that differs by more is new, independent evidence."""

COLOR = 0.45
"""Agreement of the texture that counts."""

DOUBT_LEFT = 0.5
"""Share of the doubt that a new viewpoint leaves."""

LARGEST = 0.995
"""No belief in an identity is surer."""

SAME_WAY = np.radians(30.0)
"""A correction that turns the object further says that another side of it was seen."""


def turned_over(T_before: Float64, T_after: Float64) -> bool:
    """Whether a correction says that the object was taken for another side of itself: then what was learnt
    about the old pose says nothing about the new one."""
    return bool(se3.rotation_angle(T_before, T_after) > SAME_WAY)


@dataclass(frozen=True, eq=False)
class Identity:
    """value: probability in 0..1; view (3,): direction from the object to the camera, object axes, from which
    it was last learnt."""

    value: float
    view: Float64

    @staticmethod
    def of(quality: float, view: Float64) -> Identity:
        """Of a pose that perception is that sure of."""
        return Identity(min(max(quality, 0.0), LARGEST), view)

    def agreed(self, quality: float, view: Float64) -> Identity:
        """After perception found the same pose by itself, being that sure of it. From the same viewpoint it
        would make the same mistake again, so there it leaves some of the doubt, whatever it says."""
        left = 1.0 - quality
        if float(view @ self.view) > np.cos(NEW_VIEW):
            left = max(left, DOUBT_LEFT)
        return Identity.of(max(quality, 1.0 - (1.0 - self.value) * left), view)

    def carried(self, terms: Terms, view: Float64) -> Identity:
        """After a frame that supports the pose, seen from `view`."""
        if terms.color < COLOR or float(view @ self.view) > np.cos(NEW_VIEW):
            return self
        return Identity.of(1.0 - (1.0 - self.value) * DOUBT_LEFT, view)
