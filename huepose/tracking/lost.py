"""Where a lost object may be: where it stood, as soon as that is in view again, and the place of the picture
that looks most like it. Pure functions."""

from __future__ import annotations

from huepose.believe.logistic import probability
from huepose.geometry.frame import RgbdFrame
from huepose.judge.terms import NOTHING
from huepose.refine.photometric import FULL
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.elsewhere import likeliest_place
from huepose.tracking.hypothesis import Hypothesis, distinct
from huepose.tracking.motion import jump_odds
from huepose.tracking.opinions import weighed
from huepose.tracking.refined import best_of, unmoved
from huepose.tracking.stages import RETURNING_SEEN, found_at
from huepose.tracking.subject import Subject
from huepose.tracking.usual import Usual

MOSTLY = 0.5
"""Share of an object's surface that has to be in view where it stood to say that it is not there any more."""


def found_standing(
    subject: Subject, stood: Hypothesis, frame: RgbdFrame, usual: Usual, config: TrackerConfig
) -> tuple[tuple[Hypothesis, ...], bool]:
    """The hypothesis of an object where it `stood`, none where it does not seem to be; and whether it may
    stand there all the same, because too little of that place is in view."""
    surface = subject.surface
    there = unmoved(surface, frame, stood.T_cam_obj, usual.light).terms
    in_view = 1.0 - there.hidden - there.outside - there.blind
    if there is NOTHING or in_view < RETURNING_SEEN:
        return (), True
    h = best_of(surface, frame, [(stood.T_cam_obj, "still")], usual.light)
    jump = jump_odds(surface, stood.T_cam_obj, stood.T_cam_obj, h.T_cam_obj, 0.0, config)
    return _believed((weighed(subject, h, frame, usual, 0.0, jump),), config), in_view < MOSTLY


def found_elsewhere(
    subject: Subject,
    seen: Hypothesis,
    gone_s: float,
    frame: RgbdFrame,
    usual: Usual,
    part: int,
    config: TrackerConfig,
) -> tuple[tuple[Hypothesis, ...], float]:
    """Hypotheses, best first, of an object `seen` last `gone_s` seconds ago, at the place of one part
    of the picture that looks most like it; none where it does not seem to be. They are all of one place:
    which way round it is there need not be known. And how many costly proposals that took."""
    place = likeliest_place(subject.model, subject.views, frame, part)
    if place is None:
        return (), 1.0
    surface = subject.surface
    found = []
    for T in found_at(subject, frame, place, usual.light):
        h = best_of(surface, frame, [(subject.like(T, seen.T_cam_obj), "views")], usual.light, 0, FULL)
        jump = jump_odds(surface, seen.T_cam_obj, seen.T_cam_obj, h.T_cam_obj, gone_s, config)
        found.append(weighed(subject, h, frame, usual, 0.0, jump))
    return _believed(distinct(subject, found), config), 2.0


def _believed(found: tuple[Hypothesis, ...], config: TrackerConfig) -> tuple[Hypothesis, ...]:
    """What was found, best first, if that may be the object; else nothing."""
    if not found or evidence.one_sense(found[0].terms):
        return ()
    return found if probability(found[0].log_odds) >= config.suspect_quality else ()
