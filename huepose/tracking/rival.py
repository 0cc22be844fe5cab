"""Whether the object is turned as it is believed to be, where what is in view may not tell.

Plain sides of a box, a label that repeats, a part of one colour: the object turned so that its shape nearly
fits could be meant as well. Then only where it came from tells, and that only if it cannot have turned so
far meanwhile. So the best of the other turns that it can have reached is judged, too, and while it has a
chance it is remembered as one: until a view comes that tells them apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from huepose.believe.logistic import probability
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.open_region import OpenRegion
from huepose.judge.surface import SAMPLES, PreparedSurface
from huepose.judge.terms import score_arrays
from huepose.refine.photometric import COARSE, refine_all
from huepose.select.distinct import RIGHT
from huepose.tracking.evidence import odds_of
from huepose.tracking.hypothesis import Hypothesis, same_pose
from huepose.tracking.step import Subject, best_of, region_of

SHARPNESS = 12.0
"""Log-odds for a total that is greater by 1, between the right pose and the turned one that is most like it:
the likeliest on the drawn films of the split `fit` (`studies.stress`)."""

NEW_VIEW = np.radians(25.0)
"""From a viewpoint this much different, what is seen is new evidence."""

SAME_VIEW = np.radians(8.0)
"""Within this, it is what was seen before."""

ABOUT = np.radians(15.0)
"""A refinement of a turned pose turns it by no more."""

COARSELY, TRIES = 8, 3
"""So many of the turned poses are refined coarsely, and of those that do not lead back to the pose itself so
many closely, until one of them does not either."""

COSTS = 0.5
"""Of a dear proposal: to ask takes 3 to 8 ms."""

SETTLED, MOST = odds_of(0.99), 6.0
"""Log-odds from which on nothing is asked any more (99 %), and the most."""


@dataclass(frozen=True, eq=False)
class Facing:
    """That the object is turned as it is believed to be. value: log-odds; base: the same before what is seen
    from about `view` (3,), a direction to the camera in object axes; doubted (M,): which of the other turns
    are not ruled out by where it came from; asked (3,): the view that was judged last."""

    value: float
    base: float
    view: Float64
    doubted: Bool
    asked: Float64 | None = None

    @staticmethod
    def of(quality: float, view: Float64, turns: int) -> Facing:
        """Of a pose that perception is that sure of, of an object with so many other turns."""
        return Facing(odds_of(quality), odds_of(quality), view, np.ones(turns, bool))

    @property
    def probability(self) -> float:
        """In 0..1."""
        return probability(self.value)

    @property
    def settled(self) -> bool:
        """No other turn has a chance."""
        return self.value >= SETTLED

    def open(self, view: Float64) -> bool:
        """Whether another turn has a chance, and the view may tell more than the last one did."""
        seen = self.asked is not None and float(view @ self.asked) > np.cos(SAME_VIEW)
        return not self.settled and not seen

    def jumped(self, view: Float64, reached: Bool) -> Facing:
        """After a step in which it can have turned into any of those (M,): nothing is known beforehand of
        them and of what was in doubt already. What was ruled out stays so."""
        doubted = reached if self.settled else reached | self.doubted
        return Facing(min(self.value, 0.0), min(self.value, 0.0), view, doubted)

    def assured(self, quality: float) -> Facing:
        """After perception found the same pose by itself, being that sure of it."""
        base = max(self.base, odds_of(quality))
        return replace(self, base=base, value=max(self.value, base))

    def told(self, margin: float, view: Float64) -> Facing:
        """After the total of the pose was found to be greater by that than that of its best rival. Of what is
        seen from about one view, what says most counts: a label that goes out of sight is no less true."""
        base, about, said = self.base, self.view, self.value - self.base
        if float(view @ about) < np.cos(NEW_VIEW):
            base, about, said = self.value, view, 0.0
        says = SHARPNESS * margin
        value = float(np.clip(base + (says if abs(says) > abs(said) else said), -MOST, MOST))
        return Facing(value, base, about, self.doubted, view)


def best_rival(
    subject: Subject, first: Hypothesis, turns: Float64, frame: RgbdFrame, light: Float64 | None
) -> Hypothesis | None:
    """The best of a pose after the turns (M, 4, 4), refined; None where none can be, or the likeliest of them
    lead back to the pose itself."""
    surface = subject.surface
    region = region_of(surface, frame, first.T_cam_obj) if len(turns) else None
    if region is None:
        return None
    region = region.lit(light)
    poses = _best(surface, region, np.ascontiguousarray(first.T_cam_obj @ turns))[:COARSELY]
    near = refine_all(surface, region, poses, COARSE, float(surface.centre_cam(first.T_cam_obj)[2]))
    apart = [T for T in near if not same_pose(surface, T, first.T_cam_obj, RIGHT)]
    for T in _best(surface, region, np.array(apart))[:TRIES] if apart else ():
        found = best_of(surface, frame, [(T, "turn")], light, 0)
        if not same_pose(surface, found.T_cam_obj, first.T_cam_obj, RIGHT):
            return found
    return None


def _best(surface: PreparedSurface, region: OpenRegion, poses: Float64) -> Float64:
    """Poses (K, 4, 4), best first."""
    rated = score_arrays(surface.arrays, region.arrays, poses, SAMPLES)[:, 0]
    return np.ascontiguousarray(poses[np.argsort(-rated, kind="stable")])


def reached(turns: Float64, T_cam_obj: Float64, expected: Float64, radians: float) -> Bool:
    """Which of the turns (M, 4, 4) of a pose it can have come to as well, by turning no farther than that
    from where it is expected, or than to the pose itself."""
    return _within(turns, T_cam_obj, expected, max(radians, se3.rotation_angle(T_cam_obj, expected)))


def alike(turns: Float64, T_cam_obj: Float64, T_other: Float64) -> Bool:
    """Which of the turns (M, 4, 4) lead from a pose to about another."""
    return _within(turns, T_cam_obj, T_other, ABOUT)


def _within(turns: Float64, T_cam_obj: Float64, T_other: Float64, radians: float) -> Bool:
    R = T_other[:3, :3].T @ T_cam_obj[:3, :3]
    traces = np.einsum("ij,kji->k", R, turns[:, :3, :3])
    return np.asarray((traces - 1.0) / 2.0 >= np.cos(min(radians, np.pi)) - 1e-9)
