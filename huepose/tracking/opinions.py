"""What is believed of each hypothesis of a frame: its log-odds, from the picture, its past and its motion;
and what may be believed of a lost object at the place that looks most like it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from huepose.believe.logistic import probability
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.borders import continued
from huepose.refine.ends import moved_to_ends
from huepose.refine.photometric import FULL
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.hypothesis import Anchor, Hypothesis, distinct
from huepose.tracking.motion import Reach, filtered, increment_velocity, jump_odds, predicted
from huepose.tracking.refined import best_of, unmoved
from huepose.tracking.stages import found_at
from huepose.tracking.step import WHOLLY_HIDDEN, Advance
from huepose.tracking.subject import Subject
from huepose.tracking.uncertainty import FIXED, uncertainty
from huepose.tracking.usual import Usual

UNSUPPORTED = 0.1
"""Log-odds by which a jump that nothing supports, or any such pose while the object is hidden where it is
expected, is less likely than that place: any that make it the second. It is followed all the same."""


def opinions(
    subject: Subject,
    anchor: Anchor,
    found: Advance,
    frame: RgbdFrame,
    config: TrackerConfig,
    impossible: Callable[[Hypothesis, Hypothesis, float, float], bool],
) -> list[Hypothesis]:
    """All that a step found, with log-odds and velocity, the followed ones first, in the order of the
    anchor's. impossible: whether a proposal cannot be, beside the first followed hypothesis, after so many
    seconds, and where another turn must lead by that much."""
    before = anchor.first
    seconds = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9
    gone_s = seconds + anchor.unseen_s
    out = [
        _moved(subject, anchor, h, parent, seconds, frame)
        for h, parent in zip(found.followed, anchor.hypotheses, strict=False)
    ]
    at_its_ends = _held_by_its_ends(subject, out[0], frame, anchor.usual.light)
    if at_its_ends is not None:
        out.append(_moved(subject, anchor, at_its_ends, before, seconds, frame))
    expected = predicted(subject.surface, before.T_cam_obj, before.velocity, seconds)
    for h in found.proposed:
        if impossible(h, found.followed[0], gone_s, found.least_lead):
            continue
        h = replace(h, T_cam_obj=subject.like(h.T_cam_obj, expected))
        jump = jump_odds(subject.surface, before.T_cam_obj, expected, h.T_cam_obj, gone_s, config)
        opinion = _moved(subject, anchor, h, before, seconds, frame, jump)
        # A jump, or a motion that was not seen, does not measure the velocity.
        came = jump == 0.0 and anchor.unseen_s == 0.0
        out.append(opinion if came else replace(opinion, velocity=None))
    covered = out[0].terms.hidden > WHOLLY_HIDDEN
    for k, h in enumerate(out):
        if k > 0 and (covered or h.jump < 0.0) and probability(h.log_odds) < config.lost_quality:
            out[k] = replace(h, log_odds=min(h.log_odds, out[0].log_odds - UNSUPPORTED))
    return out


def _moved(
    subject: Subject,
    anchor: Anchor,
    h: Hypothesis,
    parent: Hypothesis,
    seconds: float,
    frame: RgbdFrame,
    jump: float = 0.0,
) -> Hypothesis:
    """A hypothesis with its log-odds and filtered velocity. parent: the hypothesis it came from, `seconds`
    ago; jump: log-odds of its motion."""
    measured = increment_velocity(subject.surface, parent.T_cam_obj, h.T_cam_obj, seconds)
    velocity = filtered(parent.velocity, measured, seconds)
    opinion = weighed(subject, h, frame, anchor.usual, parent.log_odds, jump)
    return replace(opinion, velocity=velocity)


def weighed(
    subject: Subject,
    h: Hypothesis,
    frame: RgbdFrame,
    usual: Usual,
    before: float,
    jump: float = 0.0,
) -> Hypothesis:
    """A hypothesis with its log-odds; before and jump as in `evidence.log_odds`."""
    goes_on = continued(subject.contours, h.T_cam_obj, frame)
    odds = evidence.log_odds(h.terms, usual.baseline, before, goes_on, usual.light, jump)
    return replace(h, log_odds=odds, goes_on=goes_on, jump=jump)


def _held_by_its_ends(
    subject: Subject, h: Hypothesis, frame: RgbdFrame, light: Float64 | None
) -> Hypothesis | None:
    """A followed pose that could slide along the object's surface, moved so that its outline fits; or
    None."""
    if h.goes_on == 0.0 and uncertainty(subject, h)[1] < FIXED:
        return None
    T = moved_to_ends(subject.contours, h.T_cam_obj, frame)
    if T is None:
        return None
    return replace(unmoved(subject.surface, frame, T, light), information=h.information)


def found_again(
    subject: Subject,
    seen: Hypothesis,
    gone_s: float,
    frame: RgbdFrame,
    usual: Usual,
    place: Reach,
    config: TrackerConfig,
) -> tuple[Hypothesis, ...]:
    """Hypotheses, best first, of an object that was `seen` last `gone_s` seconds ago; none where it does not
    seem to be. They are all of one place: which way round it is there need not be known."""
    surface = subject.surface
    found = []
    for T in found_at(subject, frame, place, usual.light):
        h = best_of(surface, frame, [(subject.like(T, seen.T_cam_obj), "views")], usual.light, 0, FULL)
        jump = jump_odds(surface, seen.T_cam_obj, seen.T_cam_obj, h.T_cam_obj, gone_s, config)
        found.append(weighed(subject, h, frame, usual, 0.0, jump))
    opinions = distinct(subject, found)
    if not opinions or evidence.one_sense(opinions[0].terms):
        return ()
    return opinions if probability(opinions[0].log_odds) >= config.suspect_quality else ()
