"""What may be believed of a lost object at the place in the picture that looks most like it."""

from __future__ import annotations

from dataclasses import replace

from huepose.believe.logistic import probability
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.borders import outline
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.hypothesis import Hypothesis, distinct
from huepose.tracking.reach import Reach, jump_odds
from huepose.tracking.step import best_of, found_at
from huepose.tracking.subject import Subject


def found_again(
    subject: Subject,
    seen: Hypothesis,
    gone_s: float,
    frame: RgbdFrame,
    light: Float64 | None,
    baseline: float | None,
    place: Reach,
    config: TrackerConfig,
) -> tuple[Hypothesis, ...]:
    """Hypotheses, best first, of an object that was `seen` last `gone_s` seconds ago; none where it does not
    seem to be. They are all of one place: which way round it is there need not be known."""
    surface = subject.surface
    found = []
    for T in found_at(subject, frame, place, light):
        h = best_of(surface, frame, [(T, "views")], light, 0)
        goes_on = outline(subject.contours, h.T_cam_obj, frame).goes_on
        jump = jump_odds(surface, seen.T_cam_obj, seen.T_cam_obj, h.T_cam_obj, gone_s, config)
        odds = evidence.log_odds(h.terms, baseline, 0.0, goes_on, light, jump)
        found.append(replace(h, log_odds=odds, goes_on=goes_on))
    opinions = distinct(surface, found)
    if not opinions or evidence.one_sense(opinions[0].terms):
        return ()
    return opinions if probability(opinions[0].log_odds) >= config.suspect_quality else ()
