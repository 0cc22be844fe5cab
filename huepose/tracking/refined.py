"""A pose in one frame: the best of several starting poses, refined and judged. Pure functions."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAR_M
from huepose.geometry.frame import RgbdFrame
from huepose.judge.open_region import SAMPLES, OpenRegion, PreparedSurface, open_region, terms_at, totals
from huepose.judge.terms import NOTHING, score_arrays
from huepose.refine.photometric import FINE, FULL, NEAR, Schedule, refine
from huepose.tracking.evidence import OPEN
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.subject import FAR_SLIDES, Subject

START_SAMPLES = 150
"""Surface samples for choosing the best of several starting poses."""

MARGIN_M = 0.012
"""How far refinement may move the object out of the window of its starting pose."""

SETTLED_M = 0.004
MORE_PASSES = 3
"""Refinement of the first hypothesis is repeated, at most MORE_PASSES times, while it moves the object's rim
by more than SETTLED_M. Other hypotheses are refined further in the next frame."""

PULLED_AWAY = 0.1
"""If refinement lowers the total by more than this, it has converged to something else, and the starting pose
is kept."""

ROLLED_BACK = 0.015
"""A rotation about the axis of revolution is accepted if its total is this much higher; less is chance.
Chosen on rendered scenes of a printed bottle, cans, mugs and bowls."""

ROLLED_OVER = 0.03
"""A rotation of a slender object by any angle is accepted if its total is this much higher and hardly any of
the object (`OPEN`) is occluded: a small print may be the only evidence, and be occluded. Chosen on sequences
of a handle."""


def followed(
    surface: PreparedSurface,
    frame: RgbdFrame,
    before: Hypothesis,
    expected: Float64,
    light: Float64 | None,
    more_passes: int,
) -> tuple[Hypothesis, OpenRegion | None]:
    """A hypothesis of the last frame, refined in this one from its last or its expected pose, and the window
    in which it was refined; None outside of the image."""
    starts = [(before.T_cam_obj, "still")]
    if expected is not before.T_cam_obj:
        starts.append((expected, "velocity"))
    region = _region_around(surface, frame, starts, light)
    return _best_in(surface, region, starts, more_passes, NEAR), region


def best_of(
    surface: PreparedSurface,
    frame: RgbdFrame,
    starts: list[tuple[Float64, str]],
    light: Float64 | None = None,
    more_passes: int = MORE_PASSES,
    schedule: Schedule = NEAR,
) -> Hypothesis:
    """Refine the starting pose with the highest total and judge the result. starts: poses (4, 4) with their
    sources; schedule: of the refinement, by the possible error of the starts."""
    return _best_in(surface, _region_around(surface, frame, starts, light), starts, more_passes, schedule)


def _region_around(
    surface: PreparedSurface, frame: RgbdFrame, starts: list[tuple[Float64, str]], light: Float64 | None
) -> OpenRegion | None:
    boxes = [b for b in (surface.box(T, frame.camera) for T, _ in starts) if b is not None]
    z = float(surface.centre_cam(starts[-1][0])[2])
    return _window(surface, frame, Box.around(*boxes), z, light) if boxes else None


def _best_in(
    surface: PreparedSurface,
    region: OpenRegion | None,
    starts: list[tuple[Float64, str]],
    more_passes: int,
    schedule: Schedule,
) -> Hypothesis:
    if region is None:
        return Hypothesis(starts[-1][0], NOTHING, np.zeros((6, 6)), starts[-1][1])
    poses = np.array([T for T, _ in starts])
    chosen = int(np.argmax(totals(surface, region, poses, START_SAMPLES))) if len(starts) > 1 else 0
    T_start, name = starts[chosen]
    refined, T = refine(surface, region, T_start, schedule), T_start
    for _ in range(more_passes):
        if moved_m(surface, T, refined.T_cam_obj) < SETTLED_M:
            break
        T = refined.T_cam_obj
        refined = refine(surface, region, T, schedule)
    refined_terms, unmoved_terms = terms_at(surface, region, refined.T_cam_obj, T_start)
    best = Hypothesis(refined.T_cam_obj, refined_terms, refined.information, name)
    if unmoved_terms.total > best.terms.total + PULLED_AWAY:
        # Pulled away by something close, such as a hand that holds the object: use near readings only.
        careful = refine(surface, region, T_start, FINE)
        seen = terms_at(surface, region, careful.T_cam_obj)[0]
        if seen.total > best.terms.total:
            best = Hypothesis(careful.T_cam_obj, seen, careful.information, name)
        if unmoved_terms.total > best.terms.total:
            best = Hypothesis(T_start, unmoved_terms, best.information, name)
    return best


def or_from_afar(
    surface: PreparedSurface, frame: RgbdFrame, near: Hypothesis, start: Float64, light: Float64 | None
) -> Hypothesis:
    """The better of two poses by total: the given one, refined from close by, and one refined from `start`
    with the schedule for larger errors."""
    wide = best_of(surface, frame, [(start, near.source)], light, schedule=FULL)
    return max(near, wide, key=lambda h: h.terms.total)


def unmoved(
    surface: PreparedSurface, frame: RgbdFrame, T_cam_obj: Float64, light: Float64 | None
) -> Hypothesis:
    """A pose as it is, judged in a frame."""
    region = region_of(surface, frame, T_cam_obj, light)
    terms = NOTHING if region is None else terms_at(surface, region, T_cam_obj)[0]
    return Hypothesis(T_cam_obj, terms, np.zeros((6, 6)), "velocity")


def about_its_axis(
    subject: Subject,
    frame: RgbdFrame,
    followed: Hypothesis,
    light: Float64 | None,
    known: bool,
    least_lead: float = 0.0,
    region: OpenRegion | None = None,
) -> tuple[Hypothesis, float, tuple[Hypothesis, ...]]:
    """Try rotations of a pose about its axis of revolution: a refinement converges only within about the
    width of a letter on the label. Returns the pose (for a `known` object the result of the rotation that
    explains more, if there is one); its total minus that after the best small rotation; and that rotation as
    a proposal if it is better. least_lead: by how much of a total a rotation of more than half a step must be
    better; region: a window around the pose, if there is one already."""
    surface, total = subject.surface, followed.terms.total
    rolls = subject.rolls if followed.terms.hidden < OPEN else subject.rolls[:0]
    turns = np.concatenate([subject.slides, rolls]) if known else subject.small_turns
    if len(turns) and region is None:
        region = region_of(surface, frame, followed.T_cam_obj, light)
    if known and len(turns) and region is not None:
        back = np.where(FAR_SLIDES, max(ROLLED_BACK, least_lead), ROLLED_BACK)[: len(subject.slides)]
        gain = np.append(back, np.full(len(rolls), ROLLED_OVER))
        poses = followed.T_cam_obj @ turns
        rated = score_arrays(surface.arrays, region.arrays, poses, SAMPLES)[:, 0]
        k = int(np.argmax(rated - gain))
        if rated[k] >= total - ROLLED_BACK:
            best = best_of(surface, frame, [(poses[k], followed.source)], light, 0)
            if best.terms.total > total + gain[k]:
                followed, total = best, best.terms.total
                region = region_of(surface, frame, best.T_cam_obj, light)
    if region is None or not len(subject.small_turns):
        return followed, np.inf, ()
    poses, rated = ranked(surface, region, followed.T_cam_obj @ subject.small_turns)
    margin = total - float(rated[0])
    better = (best_of(surface, frame, [(poses[0], "turn")], light, 0),) if margin < -least_lead else ()
    return followed, margin, better


def ranked(surface: PreparedSurface, region: OpenRegion, poses: Float64) -> tuple[Float64, Float64]:
    """Poses (K, 4, 4), best first, and their totals (K,)."""
    rated = score_arrays(surface.arrays, region.arrays, np.ascontiguousarray(poses), SAMPLES)[:, 0]
    order = np.argsort(-rated, kind="stable")
    return np.ascontiguousarray(poses[order]), rated[order]


def region_of(
    surface: PreparedSurface, frame: RgbdFrame, T_cam_obj: Float64, light: Float64 | None
) -> OpenRegion | None:
    """The window of a frame in which a pose is judged; None outside of the image."""
    box, z = surface.box(T_cam_obj, frame.camera), float(surface.centre_cam(T_cam_obj)[2])
    return None if box is None else _window(surface, frame, box, z, light)


def moved_m(surface: PreparedSurface, T_a: Float64, T_b: Float64) -> float:
    """How far the object's centre and rim moved at most."""
    shift = se3.length(surface.centre_cam(T_a) - surface.centre_cam(T_b))
    return shift + surface.radius_m * se3.rotation_angle(T_a, T_b)


def _window(
    surface: PreparedSurface, frame: RgbdFrame, box: Box, z: float, light: Float64 | None
) -> OpenRegion | None:
    margin = max(8.0, MARGIN_M / max(z, NEAR_M) * frame.camera.fx)
    region = open_region(frame, box.grown(0.0, margin), z, surface.diameter_m)
    return None if region is None else region.lit(light)
