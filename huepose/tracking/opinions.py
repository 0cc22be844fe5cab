"""The log-odds of each hypothesis of a frame, from the image, the last frame and its motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from huepose.believe import frame as believed
from huepose.believe.logistic import probability
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.borders import continued
from huepose.refine.ends import moved_to_ends
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.hypothesis import FOLLOWED, Anchor, Hypothesis
from huepose.tracking.motion import filtered, increment_velocity, jump_odds
from huepose.tracking.refined import unmoved
from huepose.tracking.step import WHOLLY_HIDDEN, Advance
from huepose.tracking.subject import Subject
from huepose.tracking.uncertainty import FIXED, uncertainty
from huepose.tracking.usual import Usual

UNSUPPORTED = 0.1
"""A jump that the frame does not support gets log-odds this far below those of the followed pose, and so does
any proposal without support while the object is occluded at its expected place. So it stays the second
hypothesis, and is followed."""


def opinions(
    subject: Subject,
    anchor: Anchor,
    found: Advance,
    frame: RgbdFrame,
    config: TrackerConfig,
    impossible: Callable[[Hypothesis, Hypothesis, float, float], bool],
) -> list[Hypothesis]:
    """All hypotheses of a step, with log-odds and velocity, the followed ones first, in the order of the
    anchor's. impossible: whether the object cannot have made the motion to a proposal, by that proposal,
    the first followed hypothesis, the seconds since it was last seen, and the least lead of another
    orientation."""
    before = anchor.first
    seconds = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9
    gone_s = seconds + anchor.unseen_s
    out = [
        _moved(subject, anchor, h, parent, seconds, frame)
        for h, parent in zip(found.followed, anchor.hypotheses, strict=False)
    ]
    at_outline = _moved_to_outline(subject, out[0], frame, anchor.usual.light)
    if at_outline is not None:
        out.append(_moved(subject, anchor, at_outline, before, seconds, frame))
    for h in found.proposed:
        if impossible(h, found.followed[0], gone_s, found.least_lead):
            continue
        h = replace(h, T_cam_obj=subject.like(h.T_cam_obj, found.expected))
        jump = jump_odds(subject.surface, before.T_cam_obj, found.expected, h.T_cam_obj, gone_s, config)
        opinion = _moved(subject, anchor, h, before, seconds, frame, jump)
        # A jump, or a motion that no frame shows, does not measure the velocity.
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
    # An object that was found, not followed, has to show its colours.
    unread = believed.unread(h.terms) if anchor.known and h.source in FOLLOWED else 0.0
    return weighed(subject, h, frame, anchor.usual, parent.log_odds, jump, unread, velocity)


def weighed(
    subject: Subject,
    h: Hypothesis,
    frame: RgbdFrame,
    usual: Usual,
    before: float,
    jump: float = 0.0,
    unread: float = 0.0,
    velocity: Float64 | None = None,
) -> Hypothesis:
    """A hypothesis with its log-odds and this velocity; before, jump and unread as in
    `evidence.log_odds`."""
    goes_on = continued(subject.contours, h.T_cam_obj, frame)
    odds = evidence.log_odds(h.terms, usual.baseline, before, goes_on, usual.light, jump, unread)
    return Hypothesis(h.T_cam_obj, h.terms, h.information, h.source, velocity, odds, goes_on, jump)


def _moved_to_outline(
    subject: Subject, h: Hypothesis, frame: RgbdFrame, light: Float64 | None
) -> Hypothesis | None:
    """A followed pose that may have slid along the object's faces, moved so that its outline fits the depth
    discontinuity; or None."""
    if h.goes_on == 0.0 and uncertainty(subject, h)[1] < FIXED:
        return None
    T = moved_to_ends(subject.contours, h.T_cam_obj, frame)
    if T is None:
        return None
    return replace(unmoved(subject.surface, frame, T, light), information=h.information)
