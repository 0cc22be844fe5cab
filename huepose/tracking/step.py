"""One tracking step: from the hypotheses of one frame to those of the next. Pure functions.

Cheap sources of poses come first: the last pose, the velocity, optical flow (paper, section III-E), and then
searches of the places that the object can have reached. What does not fit into one frame's time continues in
the next. All poses are refined and judged alike; the track decides what to believe."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAR_M
from huepose.geometry.frame import RgbdFrame
from huepose.judge.open_region import SAMPLES, OpenRegion, PreparedSurface, look, open_region, totals
from huepose.judge.silhouette import visible_within
from huepose.judge.terms import NOTHING, score_arrays
from huepose.propose import flow as optical_flow
from huepose.propose.correspondences import match
from huepose.propose.relative_pose import RelativePose, RobustKabsch, lift_matches
from huepose.refine.photometric import FINE, refine
from huepose.tracking.config import TrackerConfig
from huepose.tracking.elsewhere import likeliest_place
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.motion import Reach, predicted, reaches
from huepose.tracking.search import (
    GREAT_EFFORT,
    NORMAL_EFFORT,
    PARTS,
    SMALL_EFFORT,
    is_wide,
    parts_a_try,
    search,
)
from huepose.tracking.subject import Subject

START_SAMPLES = 150
"""Surface samples by which the best of several starts is chosen."""

HIDDEN_COSTS = 0.5
"""A right pose loses this much of its total per hidden share of the object; no search is needed for that."""

MARGIN_M = 0.012
"""How far refinement may move the object out of its start's window."""

SETTLED_M = 0.004
MORE_PASSES = 3
"""Refinement of the first hypothesis is repeated, at most MORE_PASSES times, while it moves the object's rim
by more than SETTLED_M. That of others continues in the next frame."""

DRAWN_AWAY = 0.1
"""A refinement whose total falls by more than this has followed something else; its start is kept."""

ROLLED_BACK = 0.015
"""A rotation about the axis of revolution is taken where its total is so much higher; less is chance. Chosen
on drawn scenes of a printed bottle, cans, mugs and bowls."""

ROLLED_OVER, OPEN = 0.03, 0.1
"""A slender object's rotation by any angle is taken where its total is so much higher, and at most OPEN of it
is hidden: a small print may tell it, and be what is hidden. Chosen on films of a handle."""

FLOW_GROWTH = 0.3
"""Room round the object in which flow is computed, as a share of its size."""

WHOLLY_HIDDEN = 0.9
"""Hidden share above which nothing is left to be followed."""

RETURNING_SEEN = 0.2
"""If this share of an object is seen again after it was hidden, its rotation is checked."""


@dataclass(frozen=True, eq=False)
class Anchor:
    """The object in the last frame. hypotheses: best first; baseline: its usual total; light (3,): the
    light's offset of opponent colours; mask (H, W): its mask there, if known better than by rendering;
    unseen_s: for how long its pose had only been predicted; place: where the last frame looked most like it,
    if no search was made there yet; known: whether it is sure that it is this object."""

    hypotheses: tuple[Hypothesis, ...]
    frame: RgbdFrame
    baseline: float | None = None
    light: Float64 | None = None
    mask: Bool | None = None
    unseen_s: float = 0.0
    place: Reach | None = None
    known: bool = False

    @property
    def first(self) -> Hypothesis:
        """The best hypothesis."""
        return self.hypotheses[0]


FLOW, NEAR, PLACE, THERE, FAR = 0, 1, 2, 3, 4
TURN = FAR + PARTS
END = TURN + 1
"""Stages that are tried, in this order, while the best total is too low: optical flow, a search nearby, the
place that looks most like the object, a search there, parts of a wide search, near-symmetric rotations."""


@dataclass(frozen=True, eq=False)
class Advance:
    """The result of a step. followed: one per hypothesis of the anchor, in order; proposed: further ones from
    flow, search and near-symmetric rotations; tried: number of costly proposals; doubtful: the best total is
    below what is expected; begun: the stage to try next, END if all were tried; margin: total of the first
    followed one less that after the best small rotation; place: as in the anchor of the next step."""

    followed: tuple[Hypothesis, ...]
    proposed: tuple[Hypothesis, ...] = ()
    tried: int = 0
    doubtful: bool = False
    begun: int = FLOW
    margin: float = np.inf
    place: Reach | None = None


def advance(
    subject: Subject,
    anchor: Anchor,
    frame: RgbdFrame,
    config: TrackerConfig,
    relative_pose: RelativePose | None = None,
    resting: bool = False,
    begun: int = FLOW,
    tries: float = np.inf,
) -> Advance:
    """Find the object of `anchor` in a later frame. resting: all stages failed and may pause; begun: the
    stage to try next, from the last frame; tries: how many costly proposals this frame has time for."""
    surface, first = subject.surface, anchor.first
    seconds = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9
    expected = predicted(first.T_cam_obj, first.velocity, seconds)
    if anchor.unseen_s > 0.0:
        waiting = unmoved(surface, frame, expected, anchor.light)
        if waiting.terms.hidden > WHOLLY_HIDDEN:
            # Still occluded: refinement would move it onto the occluder.
            return Advance((waiting,), doubtful=True)
    gone_s = seconds + anchor.unseen_s
    near, far = reaches(surface, first.T_cam_obj, first.velocity, expected, gone_s, config)
    followed = [
        _followed(surface, frame, first, expected, anchor.light, MORE_PASSES),
        *(
            _followed(surface, frame, h, predicted(h.T_cam_obj, h.velocity, seconds), anchor.light, 0)
            for h in anchor.hypotheses[1:]
        ),
    ]
    if not far.holds(surface.centre_cam(followed[0].T_cam_obj)):
        # Faster than anything moves: the pose has followed an occluder.
        followed[0] = unmoved(surface, frame, expected, anchor.light)
    followed[0], margin, proposed = about_its_axis(subject, frame, followed[0], anchor.light, anchor.known)
    best = max([*followed, *proposed], key=lambda h: h.terms.total)
    long = seconds > config.long_step_s
    doubt = config.long_doubt if long else config.doubt
    returning = anchor.unseen_s > 0.0 and best.terms.seen >= RETURNING_SEEN
    surprising = long and moved_m(surface, best.T_cam_obj, expected) > config.surprising_m
    doubtful = not convincing(best, anchor.baseline, doubt, config)
    uneasy = surprising or returning or begun > NEAR
    if not (doubtful or uneasy):
        return Advance(tuple(followed), proposed, margin=margin)
    if doubtful and (resting or best.terms.hidden > config.hidden) and not (long or returning):
        return Advance(tuple(followed), proposed, doubtful=True, margin=margin)
    # Back in full view with its usual total: no search nearby is needed, only the check of its rotation.
    back = not long and begun <= NEAR and in_full(best, anchor.baseline, config)
    # A sudden loss of total starts again with the cheap stages.
    missed = best.terms.total < anchor.first.terms.total - doubt
    tried, rung, place = 0, FLOW if missed else begun, anchor.place
    if rung == THERE and long:
        rung = PLACE
    while rung < END:
        wide = FAR <= rung < TURN
        if rung == FLOW:
            # Flow needs pixels of the object in the last frame.
            followable = anchor.unseen_s == 0.0 and frame.camera == anchor.frame.camera
            wanted = doubtful and followable and 0.0 < seconds <= config.long_step_s
        elif rung == TURN:
            seen = len(subject.near_symmetries) > 0 and best.terms.seen >= RETURNING_SEEN
            wanted = seen and (doubtful or uneasy)
        elif rung == NEAR and is_wide(near) and not long:
            wanted = False  # It would be all of a wide search in one frame.
        elif rung == THERE:
            wanted = doubtful and place is not None
        else:
            wanted = doubtful or (rung == NEAR and uneasy and not back)
        if not wanted:
            rung += 1
            continue
        left, each = tries - tried, parts_a_try(far, long) if wide else 1
        if left < 1:
            break
        steps = int(min(left * each, TURN - rung)) if wide else 1
        if rung == FLOW:
            T = flow_start(subject, anchor, frame, expected, relative_pose or RobustKabsch(), config.flow)
            starts = [[(T, "flow")]] if T is not None and far.holds(surface.centre_cam(T)) else []
        elif rung == TURN:
            starts = [[(best.T_cam_obj @ turn, "turn") for turn in subject.near_symmetries]]
        elif wide:
            parts = range(rung - FAR, rung - FAR + steps)
            found = search(surface, frame, far, GREAT_EFFORT, anchor.light, parts)
            starts = [[(T, "search")] for T in found]
        elif rung == PLACE:
            place, starts = likeliest_place(subject.model, subject.views, frame), []
        elif rung == THERE:
            assert place is not None
            starts, place = [[(T, "views")] for T in found_at(subject, frame, place, anchor.light)], None
        else:
            found = search(surface, frame, near, NORMAL_EFFORT, anchor.light)
            starts = [[(T, "search")] for T in found]
        proposed += tuple(best_of(surface, frame, one, anchor.light, 0) for one in starts)
        best = max([best, *proposed], key=lambda h: h.terms.total)
        doubtful = not convincing(best, anchor.baseline, doubt, config)
        tried, rung = tried - (-steps // each), rung + steps
    return Advance(tuple(followed), proposed, tried, doubtful, rung, margin, place)


def about_its_axis(
    subject: Subject, frame: RgbdFrame, followed: Hypothesis, light: Float64 | None, known: bool
) -> tuple[Hypothesis, float, tuple[Hypothesis, ...]]:
    """Rotate a pose about its axis of revolution: refinement does not see further than a letter of the label
    is wide. Returns the pose, or if the object is `known` what it becomes from a rotation that explains more;
    its total less that after the best small rotation; and that rotation as a proposal if it is better."""
    surface, total = subject.surface, followed.terms.total
    rolls = subject.rolls if followed.terms.hidden < OPEN else subject.rolls[:0]
    turns = np.concatenate([subject.slides, rolls]) if known else subject.small_turns
    region = region_of(surface, frame, followed.T_cam_obj, light) if len(turns) else None
    if known and region is not None:
        gain = np.repeat([ROLLED_BACK, ROLLED_OVER], [len(subject.slides), len(rolls)])
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
    better = (best_of(surface, frame, [(poses[0], "turn")], light, 0),) if margin < 0.0 else ()
    return followed, margin, better


def ranked(surface: PreparedSurface, region: OpenRegion, poses: Float64) -> tuple[Float64, Float64]:
    """Poses (K, 4, 4), best first, and their totals (K,)."""
    rated = score_arrays(surface.arrays, region.arrays, np.ascontiguousarray(poses), SAMPLES)[:, 0]
    order = np.argsort(-rated, kind="stable")
    return np.ascontiguousarray(poses[order]), rated[order]


def found_at(subject: Subject, frame: RgbdFrame, place: Reach, light: Float64 | None) -> list[Float64]:
    """At most two poses (4, 4) at the place that looks most like the object."""
    return search(subject.surface, frame, place, SMALL_EFFORT, light)


def in_full(found: Hypothesis, baseline: float | None, config: TrackerConfig) -> bool:
    """Whether a hypothesis has the total of the object in full view."""
    total = found.terms.total
    return total >= config.doubtful_total and baseline is not None and total >= baseline - config.long_doubt


def convincing(found: Hypothesis, baseline: float | None, doubt: float, config: TrackerConfig) -> bool:
    """Whether a hypothesis has the total to be expected, so that no search is needed."""
    total, allowed = found.terms.total, doubt + HIDDEN_COSTS * found.terms.hidden
    return total >= config.doubtful_total and (baseline is None or total >= baseline - allowed)


def _followed(
    surface: PreparedSurface,
    frame: RgbdFrame,
    before: Hypothesis,
    expected: Float64,
    light: Float64 | None,
    more_passes: int,
) -> Hypothesis:
    """A hypothesis of the last frame, refined in this one from where it was or where it is expected."""
    starts = [(before.T_cam_obj, "still")]
    if expected is not before.T_cam_obj:
        starts.append((expected, "velocity"))
    return best_of(surface, frame, starts, light, more_passes)


def flow_start(
    subject: Subject,
    anchor: Anchor,
    frame: RgbdFrame,
    expected: Float64,
    relative_pose: RelativePose,
    flow_source: optical_flow.FlowSource = optical_flow.compute,
) -> Float64 | None:
    """The pose (4, 4) from optical flow: flow on the region of the old and the expected outline, matches
    filtered by mask and colour pairs, lifted to 3D, and a relative pose (paper, III-E). None if it fails."""
    surface, camera, T_last = subject.surface, frame.camera, anchor.first.T_cam_obj
    old, new = surface.box(T_last, camera), surface.box(expected, camera)
    if old is None or new is None:
        return None
    flow = flow_source(anchor.frame.color, frame.color, Box.around(old, new).grown(FLOW_GROWTH, 8.0))
    # A network may return NaN.
    if flow is None or not (np.isfinite(flow.forward).all() and np.isfinite(flow.backward).all()):
        return None
    mask = anchor.mask
    if mask is None:
        mask = visible_within(subject.mesh, T_last, anchor.frame, old)
    matches = match(anchor.frame.color, frame.color, mask, flow)
    motion = relative_pose.estimate(lift_matches(anchor.frame, frame, matches))
    return None if motion is None else se3.compose(motion.T_b_a, T_last)


def best_of(
    surface: PreparedSurface,
    frame: RgbdFrame,
    starts: list[tuple[Float64, str]],
    light: Float64 | None = None,
    more_passes: int = MORE_PASSES,
) -> Hypothesis:
    """Refine the start with the highest total and judge the result. starts: poses (4, 4) with their
    sources."""
    boxes = [b for b in (surface.box(T, frame.camera) for T, _ in starts) if b is not None]
    region = None
    if boxes:
        z = float(surface.centre_cam(starts[-1][0])[2])
        region = _window(surface, frame, Box.around(*boxes), z, light)
    if region is None:
        return Hypothesis(starts[-1][0], NOTHING, np.zeros((6, 6)), starts[-1][1])
    poses = np.array([T for T, _ in starts])
    chosen = int(np.argmax(totals(surface, region, poses, START_SAMPLES))) if len(starts) > 1 else 0
    T_start, name = starts[chosen]
    refined, T = refine(surface, region, T_start), T_start
    for _ in range(more_passes):
        if moved_m(surface, T, refined.T_cam_obj) < SETTLED_M:
            break
        T = refined.T_cam_obj
        refined = refine(surface, region, T)
    best = Hypothesis(refined.T_cam_obj, look(surface, region, refined.T_cam_obj), refined.information, name)
    unmoved_terms = look(surface, region, T_start)
    if unmoved_terms.total > best.terms.total + DRAWN_AWAY:
        # Drawn away by something close by, a hand that holds the object for one: only what is near counts.
        careful = refine(surface, region, T_start, FINE)
        seen = look(surface, region, careful.T_cam_obj)
        if seen.total > best.terms.total:
            best = Hypothesis(careful.T_cam_obj, seen, careful.information, name)
        if unmoved_terms.total > best.terms.total:
            best = Hypothesis(T_start, unmoved_terms, best.information, name)
    return best


def found_nearby(
    surface: PreparedSurface,
    T_cam_obj: Float64,
    frame: RgbdFrame,
    apart_s: float,
    light: Float64 | None,
    config: TrackerConfig,
) -> tuple[Hypothesis, int]:
    """A pose of a frame settled on that frame, or on one that was taken so many seconds before or after:
    there the object is searched for, if it is not found where it was; and how many searches that took."""
    best = best_of(surface, frame, [(T_cam_obj, "correction")], light)
    if apart_s == 0.0:
        # Perception refined it more closely, on this very frame: what explains less is no improvement.
        given = unmoved(surface, frame, T_cam_obj, light)
        better = given.terms.total > best.terms.total
        return (replace(given, information=best.information, source=best.source) if better else best), 0
    if convincing(best, None, config.doubt, config):
        return best, 0
    reach, _ = reaches(surface, T_cam_obj, None, T_cam_obj, apart_s, config)
    found = search(surface, frame, reach, NORMAL_EFFORT, light)
    more = [best_of(surface, frame, [(T, "search")], light) for T in found]
    return max([best, *more], key=lambda h: h.terms.total), 1


def unmoved(
    surface: PreparedSurface, frame: RgbdFrame, T_cam_obj: Float64, light: Float64 | None
) -> Hypothesis:
    """A pose as it is, with what is seen of it."""
    region = region_of(surface, frame, T_cam_obj, light)
    terms = NOTHING if region is None else look(surface, region, T_cam_obj)
    return Hypothesis(T_cam_obj, terms, np.zeros((6, 6)), "velocity")


def region_of(
    surface: PreparedSurface, frame: RgbdFrame, T_cam_obj: Float64, light: Float64 | None
) -> OpenRegion | None:
    """The window of a frame that a pose is looked at in; None outside of the image."""
    box, z = surface.box(T_cam_obj, frame.camera), float(surface.centre_cam(T_cam_obj)[2])
    return None if box is None else _window(surface, frame, box, z, light)


def moved_m(surface: PreparedSurface, T_a: Float64, T_b: Float64) -> float:
    """How far the object's centre and rim moved at most."""
    shift = float(np.linalg.norm(surface.centre_cam(T_a) - surface.centre_cam(T_b)))
    return shift + surface.radius_m * se3.rotation_angle(T_a, T_b)


def _window(
    surface: PreparedSurface, frame: RgbdFrame, box: Box, z: float, light: Float64 | None
) -> OpenRegion | None:
    margin = max(8.0, MARGIN_M / max(z, NEAR_M) * frame.camera.fx)
    region = open_region(frame, box.grown(0.0, margin), z, surface.diameter_m)
    return None if region is None else region.lit(light)
