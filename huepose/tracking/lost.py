"""Where a lost object may be: at its last place, as soon as that is in view again, and at the most probable
place of the image. Pure functions."""

from __future__ import annotations

import numpy as np

from huepose.believe.logistic import probability
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.camera import NEAR_M
from huepose.geometry.frame import RgbdFrame
from huepose.judge.open_region import PreparedSurface
from huepose.refine.photometric import FULL
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.elsewhere import likeliest_place
from huepose.tracking.hypothesis import Hypothesis, distinct
from huepose.tracking.motion import jump_odds
from huepose.tracking.opinions import weighed
from huepose.tracking.refined import best_of
from huepose.tracking.stages import found_at
from huepose.tracking.subject import Subject
from huepose.tracking.usual import Usual

MORE, MOSTLY = 0.2, 0.5
"""At its last place it is looked for each time that this share more of its surface is in view; for the last
time once MOSTLY is in view."""

SAMPLES, IN_FRONT = 60, 0.2
"""Points for measuring that share; a reading that is nearer by IN_FRONT diameters occludes a point."""


def visible_share(surface: PreparedSurface, T_cam_obj: Float64, frame: RgbdFrame) -> float:
    """Share of the surface visible at a pose that is inside the image and not occluded."""
    shown = surface.arrays.points[surface.shown(T_cam_obj, SAMPLES)].astype(np.float64)
    points = se3.apply(T_cam_obj, shown)
    points = points[points[:, 2] > NEAR_M]
    pixels = np.rint(frame.camera.project(points)).astype(np.int64)
    inside = ((pixels >= 0) & (pixels < (frame.camera.width, frame.camera.height))).all(1)
    columns, rows = pixels[inside].T
    read_m, slack_m = frame.depth[rows, columns], IN_FRONT * surface.diameter_m
    return float((read_m > points[inside, 2] - slack_m).sum()) / max(len(shown), 1)


def found_at_last_place(
    subject: Subject, last: Hypothesis, frame: RgbdFrame, usual: Usual, config: TrackerConfig
) -> tuple[Hypothesis, ...]:
    """The hypothesis of an object at its last place; none if it does not seem to be there."""
    h = best_of(subject.surface, frame, [(last.T_cam_obj, "still")], usual.light)
    jump = jump_odds(subject.surface, last.T_cam_obj, last.T_cam_obj, h.T_cam_obj, 0.0, config)
    return _believed((weighed(subject, h, frame, usual, 0.0, jump),), config)


def found_elsewhere(
    subject: Subject,
    last: Hypothesis,
    gone_s: float,
    frame: RgbdFrame,
    usual: Usual,
    part: int,
    config: TrackerConfig,
) -> tuple[tuple[Hypothesis, ...], float]:
    """Hypotheses, best first, of a lost object at the most probable place of one part of the image; none if
    it does not seem to be there. All are of one place: the orientation there need not be known. Also returns
    the number of costly proposals used. last: the object `gone_s` seconds ago."""
    place = likeliest_place(subject.model, subject.views, frame, part)
    if place is None:
        return (), 1.0
    surface = subject.surface
    found = []
    for T in found_at(subject, frame, place, usual.light):
        h = best_of(surface, frame, [(subject.like(T, last.T_cam_obj), "views")], usual.light, 0, FULL)
        jump = jump_odds(surface, last.T_cam_obj, last.T_cam_obj, h.T_cam_obj, gone_s, config)
        found.append(weighed(subject, h, frame, usual, 0.0, jump))
    return _believed(distinct(subject, found), config), 2.0


def _believed(found: tuple[Hypothesis, ...], config: TrackerConfig) -> tuple[Hypothesis, ...]:
    """The found hypotheses, best first, if they may be the object; else none."""
    if not found or evidence.one_sense(found[0].terms):
        return ()
    return found if probability(found[0].log_odds) >= config.suspect_quality else ()
