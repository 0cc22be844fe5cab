"""One tracking step: from the hypotheses of one frame to those of the next. Pure functions.

Each hypothesis is followed from its last pose and from its predicted one (`tracking.refined`). If the best
explains less than it should, more are proposed (`tracking.stages`). The track decides what to believe."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.open_region import PreparedSurface
from huepose.refine.photometric import FULL
from huepose.tracking.config import TrackerConfig
from huepose.tracking.hypothesis import Anchor, Hypothesis
from huepose.tracking.motion import Reach, predicted, reaches
from huepose.tracking.orientation import lead_to_turn
from huepose.tracking.refined import (
    MORE_PASSES,
    about_its_axis,
    best_of,
    followed,
    moved_m,
    or_from_afar,
    unmoved,
)
from huepose.tracking.search import NORMAL_BEAM, search
from huepose.tracking.stages import NEARBY, RETURNING_SEEN, THERE, Task, convincing, in_full, propose
from huepose.tracking.subject import Subject

WHOLLY_HIDDEN = 0.9
"""Occluded share above which nothing is left to follow."""

HIDDEN_LONG_S = 0.17
"""An object that was occluded for longer is looked for elsewhere, too. At 30 Hz it is LOST by then, and
searched for as such."""


@dataclass(frozen=True, eq=False)
class Advance:
    """The result of a step. expected (4, 4): the pose predicted from the anchor's first hypothesis; followed:
    one per hypothesis of the anchor, in order; proposed: further ones from searches and near-symmetric
    rotations; tried: number of costly proposals; doubtful: the best total is below the expected one; begun:
    the stage to try next, END if all were tried; margin: total of the first followed one less that after the
    best small rotation; place: as in the anchor of the next step; least_lead: by how much of a total a
    near-symmetric rotation must be better (see `lead_to_turn`)."""

    expected: Float64
    followed: tuple[Hypothesis, ...]
    proposed: tuple[Hypothesis, ...] = ()
    tried: int = 0
    doubtful: bool = False
    begun: int = NEARBY
    margin: float = np.inf
    place: Reach | None = None
    least_lead: float = 0.0


def advance(
    subject: Subject,
    anchor: Anchor,
    frame: RgbdFrame,
    config: TrackerConfig,
    resting: bool = False,
    begun: int = NEARBY,
    tries: float = np.inf,
) -> Advance:
    """Find the object of `anchor` in a later frame. resting: all stages failed and may pause; begun: the
    stage to try next, from the last frame; tries: number of costly proposals that this frame has time for."""
    surface, first, light = subject.surface, anchor.first, anchor.usual.light
    seconds = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9
    expected = predicted(surface, first.T_cam_obj, first.velocity, seconds)
    near, far = reaches(surface, first.T_cam_obj, first.velocity, expected, seconds + anchor.unseen_s, config)
    long = seconds > config.long_step_s
    task = partial(Task, subject, anchor, frame, config, near, far, long)
    others = tuple(
        followed(surface, frame, h, predicted(surface, h.T_cam_obj, h.velocity, seconds), light, 0)[0]
        for h in anchor.hypotheses[1:]
    )
    if anchor.unseen_s > 0.0:
        waiting = unmoved(surface, frame, expected, light)
        if waiting.terms.hidden > WHOLLY_HIDDEN:
            # Still occluded: refinement would move it onto the occluder. It may be visible elsewhere.
            for_long = seconds + anchor.unseen_s > HIDDEN_LONG_S
            best = max([waiting, *others], key=lambda h: h.terms.total)
            stage, hidden = NEARBY if anchor.place is None else THERE, task(hidden=True)
            more = propose(hidden, best, stage, tries if for_long else 0.0)
            following = NEARBY if more.place is None else THERE
            return Advance(
                expected,
                (waiting, *others),
                more.proposed,
                more.tried,
                hidden.doubts(more.best),
                following,
                place=more.place,
            )
    nearest, region = followed(surface, frame, first, expected, light, MORE_PASSES)
    found = [nearest, *others]
    if long or not convincing(nearest, anchor.usual.baseline, config.doubt, config):
        start = first.T_cam_obj if found[0].source == "still" else expected
        found[0] = or_from_afar(surface, frame, found[0], start, light)
    if not far.holds(surface.centre_cam(found[0].T_cam_obj)):
        # Faster than anything moves: the pose has followed an occluder.
        found[0] = unmoved(surface, frame, expected, light)
    least_lead = lead_to_turn(subject, anchor, found[0].T_cam_obj, seconds)
    region = region if found[0] is nearest else None
    found[0], margin, rolled = about_its_axis(
        subject, frame, found[0], light, anchor.known, least_lead, region
    )
    best = max([*found, *rolled], key=lambda h: h.terms.total)
    returning = anchor.unseen_s > 0.0 and best.terms.seen >= RETURNING_SEEN
    surprising = long and moved_m(surface, best.T_cam_obj, expected) > config.surprising_m
    uneasy = surprising or returning or begun > NEARBY
    # Back in full view with its usual total: no search nearby is needed, only the check of its rotation.
    back = not long and begun <= NEARBY and in_full(best, anchor.usual.baseline, config)
    more_task = task(uneasy=uneasy, back=back)
    doubtful = more_task.doubts(best)
    if not (doubtful or uneasy):
        return Advance(expected, tuple(found), rolled, margin=margin, least_lead=least_lead)
    if doubtful and (resting or best.terms.hidden > config.hidden) and not (long or returning):
        return Advance(expected, tuple(found), rolled, doubtful=True, margin=margin, least_lead=least_lead)
    # A sudden loss of total starts again with the cheap stages.
    missed = best.terms.total < first.terms.total - more_task.doubt
    more = propose(more_task, best, NEARBY if missed else begun, tries)
    return Advance(
        expected,
        tuple(found),
        rolled + more.proposed,
        more.tried,
        more_task.doubts(more.best),
        more.begun,
        margin,
        more.place,
        least_lead,
    )


def found_nearby(
    surface: PreparedSurface,
    T_cam_obj: Float64,
    frame: RgbdFrame,
    apart_s: float,
    light: Float64 | None,
    config: TrackerConfig,
) -> tuple[Hypothesis, int]:
    """Refine a pose of one frame in that frame, or in one that was taken `apart_s` seconds before or after.
    There the object is searched for if it is not found at the pose. Returns the result, and the number of
    searches."""
    best = best_of(surface, frame, [(T_cam_obj, "correction")], light)
    if not convincing(best, None, config.doubt, config):
        best = or_from_afar(surface, frame, best, T_cam_obj, light)
    if apart_s == 0.0:
        # Perception refined it more closely in this same frame: a lower total is no improvement.
        given = unmoved(surface, frame, T_cam_obj, light)
        better = given.terms.total > best.terms.total
        return (replace(given, information=best.information, source=best.source) if better else best), 0
    if convincing(best, None, config.doubt, config):
        return best, 0
    reach, _ = reaches(surface, T_cam_obj, None, T_cam_obj, apart_s, config)
    found = search(surface, frame, reach, NORMAL_BEAM, light)
    more = [best_of(surface, frame, [(T, "search")], light, schedule=FULL) for T in found]
    return max([best, *more], key=lambda h: h.terms.total), 1
