"""More poses for an object if those that were followed explain less than they should.

Cheap sources come first: a search nearby, the most probable place, the rest of what the object can have
reached, then its near-symmetric rotations. They are tried stage by stage until a pose explains enough. What
does not fit into one frame's time continues in the next. All poses are refined and judged in the same way."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.refine.photometric import FULL
from huepose.tracking.config import TrackerConfig
from huepose.tracking.elsewhere import likeliest_place
from huepose.tracking.hypothesis import Anchor, Hypothesis
from huepose.tracking.motion import Reach
from huepose.tracking.refined import best_of
from huepose.tracking.search import (
    GREAT_BEAM,
    NORMAL_BEAM,
    PARTS,
    SMALL_BEAM,
    is_wide,
    parts_a_try,
    search,
)
from huepose.tracking.subject import Subject

NEARBY, PLACE, THERE, FAR = 0, 1, 2, 3
TURN = FAR + PARTS
END = TURN + 1
"""Stages that are tried, in this order, while the best total is too low: a search nearby, finding the most
probable place, a search there, parts of a wide search, near-symmetric rotations."""

HIDDEN_COSTS = 0.5
"""A right pose loses this much of its total per occluded share of the object; no search is needed for
that."""

RETURNING_SEEN = 0.2
"""If this share of an object is visible again after it was occluded, its rotation is checked."""


@dataclass(frozen=True, eq=False)
class Task:
    """What more poses are proposed for: the object of `anchor` in a later frame. near, far: where it probably
    is, and where it can be; long: more than `long_step_s` later; uneasy: its pose may be wrong though it
    explains enough; back: it is in full view again, so no search nearby is needed; hidden: it is occluded
    where it is expected, so only the most probable place of the image is searched."""

    subject: Subject
    anchor: Anchor
    frame: RgbdFrame
    config: TrackerConfig
    near: Reach
    far: Reach
    long: bool
    uneasy: bool = False
    back: bool = False
    hidden: bool = False

    @property
    def doubt(self) -> float:
        """How far below its usual total the total of a pose may be."""
        return self.config.long_doubt if self.long else self.config.doubt

    def doubts(self, best: Hypothesis) -> bool:
        """Whether the best pose explains less than it should."""
        return not convincing(best, self.anchor.usual.baseline, self.doubt, self.config)

    def wants(self, stage: int, best: Hypothesis, place: Reach | None) -> bool:
        """Whether a stage is worth its time. place: the most probable place of the image, if no search was
        made there yet."""
        doubtful = self.doubts(best)
        if self.hidden and stage not in (PLACE, THERE):
            return False
        if stage == NEARBY:
            # With many rotations it would be a whole wide search in one frame.
            fits = self.long or not is_wide(self.near)
            return fits and (doubtful or (self.uneasy and not self.back))
        if stage == THERE:
            return doubtful and place is not None
        if stage == TURN:
            seen = len(self.subject.near_symmetries) > 0 and best.terms.seen >= RETURNING_SEEN
            return seen and (doubtful or self.uneasy)
        return doubtful

    def starts(
        self, stage: int, parts: range, best: Hypothesis, place: Reach | None
    ) -> list[list[tuple[Float64, str]]]:
        """What a stage proposes: lists of poses (4, 4) with their source; the best of each list is refined.
        parts: of the wide search."""
        surface, frame, light = self.subject.surface, self.frame, self.anchor.usual.light
        if stage == TURN:
            return [[(best.T_cam_obj @ turn, "turn") for turn in self.subject.near_symmetries]]
        if stage == THERE and place is not None:
            return [[(T, "views")] for T in found_at(self.subject, frame, place, light)]
        if stage == NEARBY:
            found = search(surface, frame, self.near, NORMAL_BEAM, light)
        else:
            found = search(surface, frame, self.far, GREAT_BEAM, light, parts)
        return [[(T, "search")] for T in found]


@dataclass(frozen=True, eq=False)
class Proposed:
    """proposed: poses, refined and judged; best: the best of them and of the pose before; tried: number of
    costly proposals; begun: the stage to try next, END if all were tried; place: as in `Anchor`, for the next
    frame."""

    proposed: tuple[Hypothesis, ...]
    best: Hypothesis
    tried: int
    begun: int
    place: Reach | None


def propose(task: Task, best: Hypothesis, begun: int, tries: float) -> Proposed:
    """Try stages from `begun` on until a pose explains enough, with at most `tries` costly proposals. best:
    the pose with the highest total so far."""
    surface, frame, light = task.subject.surface, task.frame, task.anchor.usual.light
    proposed: tuple[Hypothesis, ...] = ()
    tried, place = 0, task.anchor.place
    # After a long gap the stages start again; only a wide search continues with its next part.
    stage, part = (NEARBY, max(begun, FAR)) if task.long else (begun, FAR)
    while stage < END:
        if stage == FAR:
            stage = part
        if not task.wants(stage, best, place):
            stage += 1
            continue
        wide = FAR <= stage < TURN
        left, each = tries - tried, parts_a_try(task.far, task.long) if wide else 1
        if left < 1:
            break
        steps = int(min(left * each, TURN - stage)) if wide else 1
        if stage == PLACE:
            place = likeliest_place(task.subject.model, task.subject.views, frame)
        else:
            parts = range(stage - FAR, stage - FAR + steps)
            starts = task.starts(stage, parts, best, place)
            place = None if stage == THERE else place
            proposed += tuple(best_of(surface, frame, one, light, 0, FULL) for one in starts)
            best = max([best, *proposed], key=lambda h: h.terms.total)
        tried, stage = tried - (-steps // each), stage + steps
    return Proposed(proposed, best, tried, part if stage < FAR < part else stage, place)


def found_at(subject: Subject, frame: RgbdFrame, place: Reach, light: Float64 | None) -> list[Float64]:
    """At most two poses (4, 4) at the most probable place."""
    return search(subject.surface, frame, place, SMALL_BEAM, light)


def in_full(found: Hypothesis, baseline: float | None, config: TrackerConfig) -> bool:
    """Whether a hypothesis has the total of the object in full view."""
    total = found.terms.total
    return total >= config.doubtful_total and baseline is not None and total >= baseline - config.long_doubt


def convincing(found: Hypothesis, baseline: float | None, doubt: float, config: TrackerConfig) -> bool:
    """Whether a hypothesis has the total to be expected, so that no search is needed."""
    total, allowed = found.terms.total, doubt + HIDDEN_COSTS * found.terms.hidden
    return total >= config.doubtful_total and (baseline is None or total >= baseline - allowed)
