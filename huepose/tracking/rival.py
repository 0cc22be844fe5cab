"""The belief in a track's orientation, against rotations that nearly fit the object's shape.

Plain sides of a box, a repeated label, a part of one colour: the image may not tell a pose from a
near-symmetric rotation of it. Then only the motion does, as long as the object cannot have rotated so far. So
the best of the rotations that it can have reached is judged as well, and the doubt is kept until a view tells
them apart."""

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
from huepose.tracking.identity import NEW_VIEW
from huepose.tracking.step import best_of, region_of
from huepose.tracking.subject import Subject

SHARPNESS = 24.0
"""Log-odds per unit of total between the right pose and its best near-symmetric rotation; largest likelihood
of which one is right in 1,608 comparisons on drawn films of the split `fit` (`studies.stress`: hard,
household and YCB objects; docs/tracking.md)."""

SAME_VIEW = np.radians(8.0)
"""A viewpoint that differs by less than this gives the evidence that is known."""

ABOUT = np.radians(15.0)
"""Refinement rotates a pose by less than this: within it, two poses have the same orientation."""

COARSELY, TRIES = 8, 3
"""Of the rotated poses the COARSELY best are refined coarsely; of those that do not return to the pose itself
at most TRIES are refined fully, until one does not return."""

COSTS = 1.0
"""Cost of one such check (3 to 8 ms) in costly proposals."""

SETTLED, MOST = odds_of(0.99), 6.0
"""Log-odds from which on the orientation is settled (99 %), and their upper bound."""


@dataclass(frozen=True, eq=False)
class Facing:
    """The belief that the orientation is right. value: its log-odds; base: the log-odds before the evidence
    from around `view` (3,), a direction to the camera in object axes; doubted (M,): near-symmetric rotations
    that its motion does not rule out; asked (3,): the view that was judged last."""

    value: float
    base: float
    view: Float64
    doubted: Bool
    asked: Float64 | None = None

    @staticmethod
    def of(quality: float, view: Float64, turns: int) -> Facing:
        """The belief in a pose of perception with that quality; turns: number of near-symmetric rotations."""
        odds = odds_of(quality)
        return Facing(odds, odds, view, np.ones(turns, bool))

    @property
    def probability(self) -> float:
        """Probability that the orientation is right, 0 to 1."""
        return probability(self.value)

    @property
    def settled(self) -> bool:
        """Whether the orientation is certain enough that no rotation is checked."""
        return self.value >= SETTLED

    def open(self, view: Float64) -> bool:
        """Whether the orientation is in doubt and this view may give new evidence."""
        seen = self.asked is not None and float(view @ self.asked) > np.cos(SAME_VIEW)
        return not self.settled and not seen

    def jumped(self, view: Float64, reached: Bool) -> Facing:
        """The belief after a step in which the object can have made any of the rotations `reached` (M,). Its
        log-odds drop to at most 0. Rotations ruled out before stay so."""
        doubted = reached if self.settled else reached | self.doubted
        return Facing(min(self.value, 0.0), min(self.value, 0.0), view, doubted)

    def assured(self, quality: float) -> Facing:
        """The belief after perception found the same pose independently, with that quality."""
        base = max(self.base, odds_of(quality))
        return replace(self, base=base, value=max(self.value, base))

    def told(self, margin: float, view: Float64) -> Facing:
        """The belief after the pose's total was found to exceed its best rival's by `margin`. Of the evidence
        from similar views only the strongest counts: a label that leaves the view stays true."""
        base, about, said = self.base, self.view, self.value - self.base
        if float(view @ about) < np.cos(NEW_VIEW):
            base, about, said = self.value, view, 0.0
        says = SHARPNESS * margin
        value = float(np.clip(base + (says if abs(says) > abs(said) else said), -MOST, MOST))
        return Facing(value, base, about, self.doubted, view)


def best_rival(
    subject: Subject, first: Hypothesis, turns: Float64, frame: RgbdFrame, light: Float64 | None
) -> Hypothesis | None:
    """The best of the pose's near-symmetric rotations, turns (M, 4, 4), after refinement; None if the best of
    them return to the pose itself."""
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
    """Mask (M,) of the turns (M, 4, 4) of a pose that the object can have reached: rotated from the expected
    pose by no more than the limit, or no more than the pose itself."""
    return _within(turns, T_cam_obj, expected, max(radians, se3.rotation_angle(T_cam_obj, expected)))


def alike(turns: Float64, T_cam_obj: Float64, T_other: Float64) -> Bool:
    """Mask (M,) of the turns (M, 4, 4) that take one pose to about the orientation of another."""
    return _within(turns, T_cam_obj, T_other, ABOUT)


def _within(turns: Float64, T_cam_obj: Float64, T_other: Float64, radians: float) -> Bool:
    R = T_other[:3, :3].T @ T_cam_obj[:3, :3]
    traces = np.einsum("ij,kji->k", R, turns[:, :3, :3])
    return np.asarray((traces - 1.0) / 2.0 >= np.cos(min(radians, np.pi)) - 1e-9)
