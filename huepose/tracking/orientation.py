"""The orientation of a tracked object: the belief in it against rotations that nearly map the shape to
itself.

Plain sides of a box, a repeated label, a part of one colour: then the image may not distinguish a pose from a
near-symmetric rotation of it. Only the motion does, as long as the object cannot have rotated so far. So the
best of the rotations that the object can have made unnoticed is judged as well, and the doubt is kept until a
view distinguishes them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from huepose.believe.logistic import probability
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.select.shade import ABOUT
from huepose.tracking.config import TrackerConfig
from huepose.tracking.evidence import NEW_VIEW, odds_of
from huepose.tracking.hypothesis import FOUND_AGAIN, Anchor, Hypothesis, same_pose
from huepose.tracking.motion import MOST_JUMP, jump_odds, most_turned, predicted
from huepose.tracking.rival import best_rival, by_decisive_pixels, lead
from huepose.tracking.stamps import NEVER_NS
from huepose.tracking.subject import Subject

CLAIMED = 0.8
"""The highest quality that counts for the orientation of an estimate with a quality under
`confirmed_identity`.

To be confirmed, the pose then needs a lead of 0.034 of a total over its best near-symmetric rotation, more
than CHANCE."""


class Orientation:
    """The orientation of one track. facing: the belief, None before the first pose; sure, sure_ns: the last
    sure pose, from which rotation is measured, and its timestamp; turned_ns: the last timestamp at which the
    object can have made a near-symmetric rotation unnoticed."""

    def __init__(self, subject: Subject, config: TrackerConfig) -> None:
        self.facing: Facing | None = None
        self.sure: Hypothesis | None = None
        self.sure_ns = self.turned_ns = NEVER_NS
        self._subject, self._config = subject, config

    @property
    def probability(self) -> float:
        """Probability that the orientation is right; 1 if nothing was compared."""
        return 1.0 if self.facing is None else self.facing.probability

    @property
    def confirmed(self) -> bool:
        """Whether it is sure enough for a TRACKING pose."""
        return self.probability >= self._config.confirmed_turn

    @property
    def worth(self) -> float:
        """Its log-odds in units of a total."""
        return 0.0 if self.facing is None else self.facing.value / SHARPNESS

    def begin(self, quality: float, view: Float64) -> None:
        """Begin with an estimate of perception of that quality, seen from `view` (3,)."""
        counts = quality if quality >= self._config.confirmed_identity else min(quality, CLAIMED)
        self.facing = Facing.of(counts, view, len(self._subject.other_turns))

    def assure(self, quality: float) -> None:
        """Perception found the same pose independently, with that quality."""
        if self.facing is not None:
            self.facing = self.facing.assured(quality)

    def deny(self, quality: float) -> None:
        """Perception found another orientation, with that quality."""
        if self.facing is not None:
            self.facing = self.facing.denied(quality)

    def take_over(self, other: Orientation) -> None:
        """Continue with the belief of another track of the same object."""
        self.facing, self.sure = other.facing, other.sure
        self.sure_ns, self.turned_ns = other.sure_ns, other.turned_ns

    def set_back(self, by_ns: int) -> None:
        """Continue at rest, as if everything before had happened that much earlier."""
        self.sure_ns, self.turned_ns = self.sure_ns - by_ns, self.turned_ns - by_ns
        self.sure = None if self.sure is None else replace(self.sure, velocity=None)

    def seen_from(self, T_new_old: Float64) -> None:
        """Continue in the axes of a camera that has moved (as in `Hypothesis.seen_from`)."""
        self.sure = None if self.sure is None else self.sure.seen_from(T_new_old)

    def turn(self, first: Hypothesis, view: Float64, stamp_ns: int) -> None:
        """Continue with another orientation, which the next frames have to confirm."""
        self.facing = Facing.of(0.5, view, len(self._subject.other_turns))
        self.see(first, stamp_ns)

    def see(self, first: Hypothesis, stamp_ns: int) -> None:
        """Take this pose as sure: rotation is measured from here."""
        self.sure, self.sure_ns = first, stamp_ns

    def slide(self, margin: float, view: Float64, rests: bool) -> None:
        """Doubt all rotations if the object may have rotated about its axis unnoticed. margin: how far the
        total after the best small rotation is behind; rests: the object is at rest. There is no doubt if that
        rotation was as close at the last comparison from about the same viewpoint, or if the object is at
        rest and perception settled its orientation, without a comparison so far."""
        facing = self.facing
        if facing is None or facing.knows(margin, view):
            return
        if rests and facing.settled and facing.asked is None:
            self.facing = replace(facing, asked=view, lead=margin)
        elif probability(SHARPNESS * margin) < self._config.tracking_quality:
            self.facing = facing.jumped(view, np.ones(len(self._subject.other_turns), bool))

    def check(
        self,
        anchor: Anchor,
        expected: Float64 | None,
        first: Hypothesis,
        view: Float64,
        frame: RgbdFrame,
        hurry: bool,
    ) -> tuple[float, Better | None]:
        """Compare a pose with its near-symmetric rotations. If the object can have made one of them since it
        was last seen, the log-odds of its orientation drop to at most 0; an object at rest has not rotated.
        If the orientation was settled before, only those rotations are compared, else those doubted before,
        too; with `hurry` none is. expected (4, 4): predicted from the anchor's first pose, if it was. Returns
        what `ask` does."""
        # Poses while it was in doubt may have been wrong: rotation is measured from the last sure one.
        before, since_ns = anchor.first, anchor.frame.stamp_ns
        if self.sure is not None:
            before, since_ns = self.sure, self.sure_ns
        gone_s = (frame.stamp_ns - since_ns) * 1e-9
        turns, T, velocity = self._subject.other_turns, before.T_cam_obj, before.velocity
        if expected is None or before is not anchor.first:
            expected = predicted(self._subject.surface, T, velocity, gone_s)
        limit = most_turned(velocity, gone_s, self._config)
        jump = jump_odds(self._subject.surface, T, expected, first.T_cam_obj, gone_s, self._config)
        seen_before = since_ns == anchor.frame.stamp_ns and gone_s <= REST_S
        looked_for = anchor.unseen_s > 0.0 and first.source in FOUND_AGAIN
        turned_too_far = se3.rotation_angle(first.T_cam_obj, expected) > limit
        sudden = jump < 0.0 or looked_for or turned_too_far
        if sudden:
            # An implausible motion, or one that no frame shows: any rotation is possible.
            limit, self.turned_ns = np.pi, frame.stamp_ns
        new = reached(turns, first.T_cam_obj, expected, limit)
        may_rest = new.any() and not sudden and seen_before
        if may_rest and at_rest(self._subject, T, first.T_cam_obj):
            new = reached(turns, first.T_cam_obj, expected, 0.0)
        facing = self.facing or Facing.of(0.5, view, len(turns))
        if new.any():
            facing = facing.jumped(view, new)
            self.see(first, frame.stamp_ns)  # This doubt is known from here on.
        self.facing = facing
        return (0.0, None) if hurry else self.ask(first, view, frame, anchor.usual.light)

    def ask(
        self, first: Hypothesis, view: Float64, frame: RgbdFrame, light: Float64 | None
    ) -> tuple[float, Better | None]:
        """Compare a pose with the best of the doubted near-symmetric rotations, if the orientation is in
        doubt and this view may give new evidence. Returns the number of costly proposals used, and the other
        rotation if it is the one to follow."""
        if self.facing is None or not self.facing.open(view):
            return 0.0, None
        turns = self._subject.other_turns[self.facing.doubted]
        rival = best_rival(self._subject, first, turns, frame, light)
        costs = COSTS if len(turns) else 0.0
        if rival is None:
            self.facing = self.facing.compared(np.inf, view)
            return costs, None
        decisive = by_decisive_pixels(self._subject, first, rival, frame)
        margin = lead(self._subject.surface, first, rival, frame, decisive)
        self.facing = self.facing.compared(margin, view)
        left = max(decisive, margin) < -LEFT and self.facing.value < 0.0
        return costs, Better(rival, -margin) if left else None

    def impossible(self, found: Hypothesis, followed: Hypothesis, gone_s: float, least_lead: float) -> bool:
        """Whether a proposal is about a near-symmetric rotation of the followed pose that the object cannot
        have made. It cannot if the rotation is larger than any motion in `gone_s`, the orientation was
        settled, and the lead in total is not very large. Nor can an object at rest if the lead is
        `least_lead` or less (see `lead_to_turn`)."""
        leads = found.terms.total - followed.terms.total
        too_small = least_lead > 0.0 and leads <= least_lead
        too_fast = leads < OUTWEIGHS and self._too_fast(found, followed, gone_s)
        if not (too_small or too_fast):
            return False
        return bool(alike(self._subject.other_turns, followed.T_cam_obj, found.T_cam_obj).any())

    def _too_fast(self, found: Hypothesis, followed: Hypothesis, gone_s: float) -> bool:
        if self.facing is None or not self.facing.settled:
            return False
        turned = se3.rotation_angle(found.T_cam_obj, followed.T_cam_obj)
        return turned >= most_turned(None, gone_s, self._config)


def lead_to_turn(subject: Subject, anchor: Anchor, T_cam_obj: Float64, seconds: float) -> float:
    """By how much of a total a near-symmetric rotation must lead the followed pose to be accepted. An object
    at rest has not rotated: the lead has to outweigh the belief in its orientation. 0 for a moving object."""
    if seconds > REST_S or anchor.unseen_s > 0.0 or anchor.turn_odds <= 0.0 or not len(subject.other_turns):
        return 0.0
    return anchor.turn_odds / SHARPNESS if at_rest(subject, anchor.first.T_cam_obj, T_cam_obj) else 0.0


def at_rest(subject: Subject, T_before: Float64, T_cam_obj: Float64) -> bool:
    """Whether an object is at rest (`RESTS`), by its poses (4, 4) at most REST_S apart."""
    return same_pose(subject, T_before, T_cam_obj, RESTS)


SHARPNESS = 24.0
"""Log-odds per unit of total between the right pose and its best near-symmetric rotation; fitted by maximum
likelihood of the right one in 1,608 comparisons on rendered sequences of the split `fit` (`studies.stress`:
hard, household and YCB objects; docs/tracking_measured.md)."""

OUTWEIGHS = 2.0 * MOST_JUMP / SHARPNESS
"""A near-symmetric rotation that leads by this much of a total is accepted, even if nothing rotates so fast:
it is twice the most that a motion counts against a pose. Timestamps may be wrong, or objects are exchanged
while no frame shows them."""

CHANCE = 0.025
"""Differences of totals under this are chance on rendered sequences of the split `fit`."""

LEFT = 0.06
"""An orientation is left for another one that leads by this much of a total, four times as probable, if the
decisive pixels alone say so, too. Colours alone do not: they may be those of the light."""

SAME_VIEW = np.radians(8.0)
"""A viewpoint that differs by less than this gives no new evidence."""

RESTS, REST_S = 0.02, 0.5
"""An object is at rest if it has moved by less than this share of its diameter since the last frame, and that
frame is not older than this: nobody lifts an object, turns it over and puts it back so exactly in that time.
99 % of the steps of resting objects are within 0.014 (path-traced clutter, 6 Hz)."""

COSTS = 1.0
"""Cost of one such check (3 to 8 ms) in costly proposals."""

SETTLED, MOST = odds_of(0.99), 6.0
"""Log-odds above which the orientation is settled (99 %), and their upper bound."""


class Better(NamedTuple):
    """A near-symmetric rotation that is more probable than the followed pose, and by how much of a total it
    leads."""

    pose: Hypothesis
    leads: float


@dataclass(frozen=True, eq=False)
class Facing:
    """The belief that the orientation is right. value: its log-odds; base: the log-odds before the evidence
    from around `view` (3,), a direction to the camera in object axes; doubted (M,): near-symmetric rotations
    that the motion does not rule out; asked (3,): the view of the last comparison; lead: lead in total over
    the best other orientation in it; denied_by: log-odds of perception's most probable estimate from around
    `view` with another orientation."""

    value: float
    base: float
    view: Float64
    doubted: Bool
    asked: Float64 | None = None
    lead: float = 0.0
    denied_by: float = 0.0

    @staticmethod
    def of(quality: float, view: Float64, turns: int) -> Facing:
        """The belief in an estimate of perception with that quality; turns: number of near-symmetric
        rotations."""
        odds = odds_of(quality)
        return Facing(odds, odds, view, np.ones(turns, bool))

    @property
    def probability(self) -> float:
        """Probability that the orientation is right, 0 to 1."""
        return probability(self.value)

    @property
    def settled(self) -> bool:
        """Whether the orientation is so sure that no rotation is compared."""
        return self.value >= SETTLED

    def open(self, view: Float64) -> bool:
        """Whether the orientation is in doubt and this view may give new evidence."""
        seen = self.asked is not None and float(view @ self.asked) > np.cos(SAME_VIEW)
        return not self.settled and not seen

    def jumped(self, view: Float64, reached: Bool) -> Facing:
        """The belief after a step in which the object can have made any of the rotations `reached` (M,). Its
        log-odds drop to at most 0. Rotations ruled out before stay so."""
        doubted = reached if self.settled else reached | self.doubted
        denied_by = self.denied_by if float(view @ self.view) >= np.cos(NEW_VIEW) else 0.0
        value = min(self.value, 0.0)
        return Facing(value, value, view, doubted, denied_by=denied_by)

    def assured(self, quality: float) -> Facing:
        """The belief after perception found the same pose independently, with that quality."""
        base = max(self.base, odds_of(quality) - self.denied_by)
        return replace(self, base=base, value=max(self.value, base))

    def denied(self, quality: float) -> Facing:
        """The belief after perception found another orientation, with that quality. Of all estimates from one
        viewpoint only two count, since they repeat the same errors: the most probable for the orientation and
        the most probable against it."""
        denied_by = max(odds_of(quality), self.denied_by)
        less = denied_by - self.denied_by
        return replace(self, base=self.base - less, value=self.value - less, denied_by=denied_by)

    def knows(self, margin: float, view: Float64) -> bool:
        """Whether the best other orientation was as close at the last comparison, from about this
        viewpoint."""
        seen = self.asked is not None and float(view @ self.asked) > np.cos(SAME_VIEW)
        return seen and margin > self.lead - CHANCE

    def compared(self, margin: float, view: Float64) -> Facing:
        """The belief after a comparison in which the total of the pose exceeds that of its best rival by
        `margin`. Of the evidence from similar viewpoints only the strongest counts: a label that goes out of
        sight is not forgotten."""
        base, about, known, denied_by = self.base, self.view, self.value - self.base, self.denied_by
        if float(view @ about) < np.cos(NEW_VIEW):
            base, about, known, denied_by = self.value, view, 0.0, 0.0
        evidence = SHARPNESS * margin
        value = float(np.clip(base + (evidence if abs(evidence) > abs(known) else known), -MOST, MOST))
        return Facing(value, base, about, self.doubted, view, margin, denied_by)


def reached(turns: Float64, T_cam_obj: Float64, expected: Float64, radians: float) -> Bool:
    """Mask (M,) of the near-symmetric rotations `turns` (M, 4, 4) of a pose that the object can have reached:
    rotated from the expected pose by no more than the limit, or no more than the pose itself."""
    return _within(turns, T_cam_obj, expected, max(radians, se3.rotation_angle(T_cam_obj, expected)))


def alike(turns: Float64, T_cam_obj: Float64, T_other: Float64) -> Bool:
    """Mask (M,) of the near-symmetric rotations `turns` (M, 4, 4) that take one pose to about the orientation
    of another."""
    return _within(turns, T_cam_obj, T_other, ABOUT)


def another_opinion(subject: Subject, followed: Hypothesis, first: Hypothesis) -> bool:
    """Whether the viewpoint of the best pose differs from that of the followed one because the decision
    changed, not because the object moved: the best pose is about a near-symmetric rotation of the followed
    one, or no motion leads to it."""
    T, T_first = followed.T_cam_obj, first.T_cam_obj
    if se3.rotation_angle(T, T_first) <= SAME_VIEW:
        return False
    return first.jump < 0.0 or bool(alike(subject.other_turns, T, T_first).any())


def _within(turns: Float64, T_cam_obj: Float64, T_other: Float64, radians: float) -> Bool:
    R = T_other[:3, :3].T @ T_cam_obj[:3, :3]
    traces = np.einsum("ij,kji->k", R, turns[:, :3, :3])
    return np.asarray((traces - 1.0) / 2.0 >= np.cos(min(radians, np.pi)) - 1e-9)
