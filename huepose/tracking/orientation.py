"""Which way round a track's object is.

Near-symmetric rotations of a pose are doubted when the object can have made them unseen. Then the picture is
asked (`rival`)."""

from __future__ import annotations

import numpy as np

from huepose.believe.logistic import probability
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.tracking.config import TrackerConfig
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.motion import predicted
from huepose.tracking.reach import jump_odds, most_turned
from huepose.tracking.rival import COSTS, SHARPNESS, Facing, alike, best_rival, reached
from huepose.tracking.step import Anchor
from huepose.tracking.subject import Subject

LOOKED_FOR = ("search", "views")
FOUND_AGAIN = (*LOOKED_FOR, "turn")
"""Sources of hypotheses found by a search instead of followed from the last frame; FOUND_AGAIN adds those
that were followed and then turned."""

CLAIMED = 0.8
"""The most that a claim of perception under `confirmed_identity` counts for the orientation.

To be confirmed, the pose then needs a lead of 0.034 of a total over its best near-symmetric rotation. Leads
under 0.025 are chance on drawn films of the split `fit`."""


class Orientation:
    """Of one track. facing: the belief, None before the first pose; sure, sure_ns: the last sure pose, from
    which rotation is measured, and its stamp; turned_ns: the last stamp at which the object can have rotated
    by a near symmetry, unseen."""

    def __init__(self, subject: Subject, config: TrackerConfig) -> None:
        self.facing: Facing | None = None
        self.sure: Hypothesis | None = None
        self.sure_ns = self.turned_ns = 0
        self._subject, self._config = subject, config

    @property
    def probability(self) -> float:
        """That it is right; 1 where nothing was asked."""
        return 1.0 if self.facing is None else self.facing.probability

    @property
    def worth(self) -> float:
        """Its certainty in units of a total."""
        return 0.0 if self.facing is None else self.facing.value / SHARPNESS

    def begin(self, quality: float, view: Float64) -> None:
        """Begin with a pose of perception of that quality, seen from `view` (3,)."""
        counts = quality if quality >= self._config.confirmed_identity else min(quality, CLAIMED)
        self.facing = Facing.of(counts, view, len(self._subject.other_turns))

    def assure(self, quality: float) -> None:
        """Perception found the same pose independently, with that quality."""
        if self.facing is not None:
            self.facing = self.facing.assured(quality)

    def take_over(self, other: Orientation) -> None:
        """Continue with the belief of another track of the same object."""
        self.facing, self.sure = other.facing, other.sure
        self.sure_ns, self.turned_ns = other.sure_ns, other.turned_ns

    def set_back(self, stamp_ns: int) -> None:
        """Continue as if the last frame had this stamp."""
        self.sure, self.turned_ns = None, min(self.turned_ns, stamp_ns)

    def see(self, first: Hypothesis, stamp_ns: int) -> None:
        """This pose is sure: rotation is measured from here."""
        self.sure, self.sure_ns = first, stamp_ns

    def slide(self, margin: float, view: Float64) -> None:
        """Doubt all rotations where the object may have slid about its axis, unnoticed. margin: how far the
        total after the best small rotation is behind."""
        if self.facing is not None and probability(SHARPNESS * margin) < self._config.tracking_quality:
            self.facing = self.facing.jumped(view, np.ones(len(self._subject.other_turns), bool))

    def check(self, anchor: Anchor, first: Hypothesis, view: Float64, frame: RgbdFrame, hurry: bool) -> float:
        """Test a pose against its near-symmetric rotations. If the object can have turned to one of them
        since it was seen last, the log-odds of its orientation drop to at most 0. Those are tested alone if
        the orientation was settled before, else all are; in a hurry none is. Returns the number of costly
        proposals used."""
        # Poses while it was in doubt may have been wrong: rotation is measured from the last sure one.
        before, since_ns = anchor.first, anchor.frame.stamp_ns
        if self.sure is not None:
            before, since_ns = self.sure, self.sure_ns
        gone_s = (frame.stamp_ns - since_ns) * 1e-9
        turns, T, velocity = self._subject.other_turns, before.T_cam_obj, before.velocity
        expected = predicted(T, velocity, gone_s)
        limit = most_turned(velocity, gone_s, self._config)
        jump = jump_odds(self._subject.surface, T, expected, first.T_cam_obj, gone_s, self._config)
        looked_for = anchor.unseen_s > 0.0 and first.source in FOUND_AGAIN
        turned_too_far = se3.rotation_angle(first.T_cam_obj, expected) > limit
        if jump < 0.0 or looked_for or turned_too_far:
            # An implausible motion, or one that was not seen: any rotation is possible.
            limit, self.turned_ns = np.pi, frame.stamp_ns
        new = reached(turns, first.T_cam_obj, expected, limit)
        facing = self.facing or Facing.of(0.5, view, len(turns))
        if new.any():
            facing = facing.jumped(view, new)
            self.see(first, frame.stamp_ns)  # This doubt is known from here on.
        self.facing = facing
        return 0.0 if hurry else self.ask(first, view, frame, anchor.light)

    def ask(self, first: Hypothesis, view: Float64, frame: RgbdFrame, light: Float64 | None) -> float:
        """Compare a pose with the best of the doubted near-symmetric rotations, if one may be right. Returns
        the number of costly proposals used."""
        if self.facing is None or not self.facing.open(view):
            return 0.0
        turns = self._subject.other_turns[self.facing.doubted]
        rival = best_rival(self._subject, first, turns, frame, light)
        margin = np.inf if rival is None else first.terms.total - rival.terms.total
        self.facing = self.facing.told(margin, view)
        return COSTS if len(turns) else 0.0

    def turned_too_fast(self, found: Hypothesis, followed: Hypothesis, gone_s: float) -> bool:
        """Whether a proposal is about the followed pose after a near-symmetric rotation that is larger than
        the object can make in `gone_s`, while its orientation was settled. Such a proposal is dropped."""
        if self.facing is None or not self.facing.settled:
            return False
        turned = se3.rotation_angle(found.T_cam_obj, followed.T_cam_obj)
        if turned < most_turned(None, gone_s, self._config):
            return False
        return bool(alike(self._subject.other_turns, followed.T_cam_obj, found.T_cam_obj).any())
