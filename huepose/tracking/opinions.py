"""What is believed of each hypothesis of a frame: its log-odds, from the picture, its past and its motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.borders import outline
from huepose.refine.ends import moved_to_ends
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.hypothesis import POINTS, Hypothesis
from huepose.tracking.motion import filtered, increment_velocity, predicted
from huepose.tracking.reach import jump_odds
from huepose.tracking.step import Advance, Anchor, unmoved
from huepose.tracking.subject import Subject
from huepose.tracking.uncertainty import covariance, spread_m

LOOSE = 0.012
"""Expected pose error, as a share of the diameter, above which the texture does not fix the pose; textured
objects have half of it."""


class Opinions(NamedTuple):
    """all: hypotheses with log-odds and velocity, the followed ones first, in the order of the anchor's;
    leaps: poses (4, 4) of those reached by an implausible motion; covariance (6, 6), spread: of the first
    one, as of `uncertainty`."""

    all: list[Hypothesis]
    leaps: list[Float64]
    covariance: Float64
    spread: float


def opinions(
    subject: Subject,
    anchor: Anchor,
    found: Advance,
    frame: RgbdFrame,
    config: TrackerConfig,
    impossible: Callable[[Hypothesis, Hypothesis, float], bool],
) -> Opinions:
    """Of all that a step found. impossible: whether a proposal cannot be, beside the first followed
    hypothesis and after so many seconds."""
    before, leaps = anchor.first, list[Float64]()
    seconds = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9
    gone_s = seconds + anchor.unseen_s
    out = [
        _weighed(subject, anchor, h, parent, seconds, frame)
        for h, parent in zip(found.followed, anchor.hypotheses, strict=False)
    ]
    known, spread = uncertainty(subject, out[0])
    held = _held_by_its_ends(subject, out[0], spread, frame, anchor.light)
    if held is not None:
        out.append(_weighed(subject, anchor, held, before, seconds, frame))
    expected = predicted(before.T_cam_obj, before.velocity, seconds)
    for h in found.proposed:
        if impossible(h, found.followed[0], gone_s):
            continue
        jump = jump_odds(subject.surface, before.T_cam_obj, expected, h.T_cam_obj, gone_s, config)
        opinion = _weighed(subject, anchor, h, before, seconds, frame, jump)
        # A jump, or a motion that was not seen, does not measure the velocity.
        came = jump == 0.0 and anchor.unseen_s == 0.0
        out.append(opinion if came else replace(opinion, velocity=None))
        leaps += [opinion.T_cam_obj] if jump < 0.0 else []
    return Opinions(out, leaps, known, spread)


def _weighed(
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
    measured = increment_velocity(parent.T_cam_obj, h.T_cam_obj, seconds)
    velocity = filtered(parent.velocity, measured, seconds)
    goes_on = outline(subject.contours, h.T_cam_obj, frame).goes_on
    odds = evidence.log_odds(h.terms, anchor.baseline, parent.log_odds, goes_on, anchor.light, jump)
    return replace(h, velocity=velocity, log_odds=odds, goes_on=goes_on)


def _held_by_its_ends(
    subject: Subject, h: Hypothesis, spread: float, frame: RgbdFrame, light: Float64 | None
) -> Hypothesis | None:
    """A followed pose that could slide along the object's surface, moved so that its outline fits; or
    None."""
    if spread < LOOSE and h.goes_on == 0.0:
        return None
    T = moved_to_ends(subject.contours, h.T_cam_obj, frame)
    if T is None:
        return None
    return replace(unmoved(subject.surface, frame, T, light), information=h.information)


def uncertainty(subject: Subject, h: Hypothesis) -> tuple[Float64, float]:
    """Covariance (6, 6) of a pose, and its expected error as a share of the diameter."""
    surface, T = subject.surface, h.T_cam_obj
    known = covariance(h.information, float(surface.centre_cam(T)[2]))
    return known, spread_m(known, T, surface.arrays.points[:POINTS]) / surface.diameter_m
