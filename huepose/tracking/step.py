"""One step: from where an object was in one frame to where it is in another. Pure; everything is passed in.

Starts are tried from cheap to dear, and each is believed only when the image agrees: where it was, where its
velocity takes it, where optical flow takes it (paper, section III-F), and at last the tracker's own search.
What is usual for this object in this light decides when a result is doubtful.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.mesh import Mesh
from huepose.model.types import ReferenceModel
from huepose.propose import flow as optical_flow
from huepose.propose.correspondences import match
from huepose.propose.relative_pose import RelativePose, RobustKabsch, lift_matches
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.motion import predicted
from huepose.tracking.reach import Reach, reaches
from huepose.tracking.refinement import FINE, Refined, refine
from huepose.tracking.region import Region, prepare
from huepose.tracking.scoring import NOTHING, UNKNOWN_TINT, Fit, Tint, score
from huepose.tracking.search import GREAT_EFFORT, USUAL_EFFORT, Effort, search
from huepose.tracking.silhouette import visible_mask
from huepose.tracking.surface import TrackedSurface

START_SAMPLES = 150
DOUBT = 0.25
"""A score this much under the usual one is looked into."""

DOUBTFUL_TOTAL = 0.9
"""So is any score under this one."""

HIDDEN_COSTS = 0.5
"""A right pose loses about this share of what is hidden of its object: no reason to look elsewhere."""

MARGIN_M = 0.012
"""The refinement may move the object by this much out of its start's window."""

SETTLED_M = 0.004
MORE_PASSES = 3
"""A refinement that moved the object's rim by more than this is repeated, a few times."""

LONG_STEP_S = 0.1
"""After a longer time flow finds too little to be worth its own, and there is time for a search: it is made
unless the result is close to the usual score and near to where the object was expected."""

LONG_DOUBT = 0.1
SURPRISING_M = 0.03
RETURNING_SEEN = 0.2
"""When this much of an object is seen again after it was hidden, it may have turned meanwhile: it is searched
for, even if the predicted pose explains something."""

WHOLLY_HIDDEN = 0.9
"""With less hidden there is a strip to be followed."""

DRAWN_AWAY = 0.1
"""A refinement that explains this much less than its start has followed something else."""

RIVAL_MARGIN = 0.1
"""The pose before a correction must explain the image this much better to be taken back."""

TURN_MARGIN = 0.1
"""A near-symmetric turn of the object must explain the image this much better before it is believed."""

FLOW_GROWTH = 0.3


@dataclass(frozen=True, eq=False)
class Subject:
    """The object: its prepared surface, its mesh, and the turns (M, 4, 4) that nearly map its shape to
    itself, without the identity."""

    surface: TrackedSurface
    mesh: Mesh
    turns: Float64

    @staticmethod
    def of(model: ReferenceModel) -> Subject:
        """Prepare a reference model for tracking."""
        return Subject(TrackedSurface.of(model), model.mesh, np.asarray(model.turns[1:], np.float64))


@dataclass(frozen=True, eq=False)
class Anchor:
    """Where an object was last: pose, velocity (6,) or None, the frame, the score that is usual for it or
    None, and the tint of the light; its mask (H, W) in that frame where one is known better than by
    rendering; a rival: the pose that has just been corrected away; unseen_s: for how long the pose had
    only been predicted by then; tired: flow and search were tried in vain for some frames, and shall rest."""

    T_cam_obj: Float64
    velocity: Float64 | None
    frame: RgbdFrame
    usual: float | None
    tint: Tint = UNKNOWN_TINT
    mask: Bool | None = None
    rival: Float64 | None = None
    unseen_s: float = 0.0
    tired: bool = False


@dataclass(frozen=True, eq=False)
class Step:
    """Where it is now: pose, what that explains of the frame, information (6, 6) of the refinement, and
    which start led there ("still", "velocity", "flow", "search", "turn", "rival"); doubtful: it explains less
    than it should; searched: the tracker's own search was made; near: what starts near by had led to where
    the search found something that explains more."""

    T_cam_obj: Float64
    fit: Fit
    information: Float64
    start: str
    doubtful: bool = False
    searched: bool = False
    near: Step | None = None


def advance(
    subject: Subject,
    anchor: Anchor,
    frame: RgbdFrame,
    config: TrackerConfig,
    relative_pose: RelativePose | None = None,
) -> Step:
    """Find the object of `anchor` in a later frame."""
    surface = subject.surface
    seconds = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9
    expected = predicted(anchor.T_cam_obj, anchor.velocity, seconds)
    starts = [(anchor.T_cam_obj, "still")]
    if expected is not anchor.T_cam_obj:
        starts.append((expected, "velocity"))
    gone_s = seconds + anchor.unseen_s
    near, far = reaches(surface, anchor.T_cam_obj, anchor.velocity, expected, gone_s, config)
    if anchor.unseen_s > 0.0:
        waiting = _unmoved(surface, frame, expected, anchor.tint)
        if waiting.fit.hidden > WHOLLY_HIDDEN:
            # Still behind something. A refinement would lead to that, where its depth fits.
            return replace(waiting, doubtful=True)
    best = best_of(surface, frame, starts, anchor.tint)
    if not far.holds(surface.centre_cam(best.T_cam_obj)):
        # Nothing moves that fast: what was followed is what came in front.
        best = _unmoved(surface, frame, expected, anchor.tint)
    if anchor.rival is not None:
        best = _better(best, best_of(surface, frame, [(anchor.rival, "rival")], anchor.tint), by=RIVAL_MARGIN)
    long = seconds > LONG_STEP_S
    doubt = LONG_DOUBT if long else DOUBT
    surprising = long and _moved_m(surface, best.T_cam_obj, expected) > SURPRISING_M
    returning = anchor.unseen_s > 0.0 and best.fit.seen >= RETURNING_SEEN
    doubtful = not _convincing(best, anchor.usual, doubt)
    # Behind something, where it is expected, there is nothing to look for.
    resting = (anchor.tired or best.fit.hidden > evidence.HIDDEN) and not long and not returning
    if resting or not (doubtful or surprising or returning):
        return replace(best, doubtful=doubtful)
    # What was not seen in the last frame has no pixels there to be followed.
    if 0.0 < seconds <= LONG_STEP_S and anchor.unseen_s == 0.0:
        T_flow = flow_start(subject, anchor, frame, expected, relative_pose or RobustKabsch(), config.flow)
        if T_flow is not None and far.holds(surface.centre_cam(T_flow)):
            best = _better(best, best_of(surface, frame, [(T_flow, "flow")], anchor.tint))
    doubtful = not _convincing(best, anchor.usual, doubt)
    searching = config.search and (doubtful or surprising or returning)
    local = best
    if searching:
        best = _searched(best, surface, frame, near, USUAL_EFFORT, anchor.tint)
        if not _convincing(best, anchor.usual, doubt) and (long or returning):
            best = _searched(best, surface, frame, far, GREAT_EFFORT, anchor.tint)
        if len(subject.turns) and best.fit.seen >= RETURNING_SEEN:
            turned = [(best.T_cam_obj @ turn, "turn") for turn in subject.turns]
            best = _better(best, best_of(surface, frame, turned, anchor.tint), by=TURN_MARGIN)
    return replace(
        best,
        doubtful=not _convincing(best, anchor.usual, doubt),
        searched=searching,
        near=None if best is local else local,
    )


def flow_start(
    subject: Subject,
    anchor: Anchor,
    frame: RgbdFrame,
    expected: Float64,
    relative_pose: RelativePose,
    flow_source: optical_flow.FlowSource = optical_flow.compute,
    use_pairs: bool = True,
) -> Float64 | None:
    """The pose that optical flow from the anchor's frame gives: flow on the region of the old and the
    expected outline, matches filtered by mask and colour pairs, lifted, and a relative pose. None where it
    fails."""
    surface, camera = subject.surface, frame.camera
    old, new = surface.box(anchor.T_cam_obj, camera), surface.box(expected, camera)
    if old is None or new is None:
        return None
    flow = flow_source(anchor.frame.color, frame.color, _union(old, new).grown(FLOW_GROWTH, 8.0))
    if flow is None:
        return None
    mask = anchor.mask
    if mask is None:
        mask = visible_mask(subject.mesh, anchor.T_cam_obj, anchor.frame, old)
    matches = match(anchor.frame.color, frame.color, mask, flow, use_pairs)
    motion = relative_pose.estimate(lift_matches(anchor.frame, frame, matches))
    return None if motion is None else se3.compose(motion.T_b_a, anchor.T_cam_obj)


def best_of(
    surface: TrackedSurface,
    frame: RgbdFrame,
    starts: list[tuple[Float64, str]],
    tint: Tint = UNKNOWN_TINT,
) -> Step:
    """Refine the start that explains the image best before refinement."""
    boxes = [b for b in (surface.box(T, frame.camera) for T, _ in starts) if b is not None]
    region = None
    if boxes:
        z = float(surface.centre_cam(starts[-1][0])[2])
        region = prepare(frame, _with_margin(_union(*boxes), frame, z), z)
    if region is None:
        return Step(starts[-1][0], NOTHING, np.zeros((6, 6)), starts[-1][1])
    totals = [score(surface, region, T, 2, START_SAMPLES, tint).total for T, _ in starts]
    T_start, name = starts[int(np.argmax(totals))]
    refined, T = refine(surface, region, T_start), T_start
    for _ in range(MORE_PASSES):
        if _moved_m(surface, T, refined.T_cam_obj) < SETTLED_M:
            break
        T = refined.T_cam_obj
        refined = refine(surface, region, T)
    best = _scored(surface, region, refined, name, tint)
    unmoved = score(surface, region, T_start, 0, tint=tint)
    if unmoved.total > best.fit.total + DRAWN_AWAY:
        # Drawn away by something close by, a hand that holds the object for one: only what is near counts.
        careful = _scored(surface, region, refine(surface, region, T_start, FINE), name, tint)
        best = max(best, careful, key=lambda step: step.fit.total)
        if unmoved.total > best.fit.total:
            best = replace(best, T_cam_obj=T_start, fit=unmoved)
    return best


def found_nearby(
    surface: TrackedSurface, T_cam_obj: Float64, frame: RgbdFrame, apart_s: float, config: TrackerConfig
) -> Step:
    """A pose of a frame settled on that frame, or on one that was taken so many seconds before or after:
    there the object is searched for, if it is not found where it was."""
    best = best_of(surface, frame, [(T_cam_obj, "correction")])
    if apart_s == 0.0 or not config.search or _convincing(best, None, DOUBT):
        return best
    reach, _ = reaches(surface, T_cam_obj, None, T_cam_obj, apart_s, config)
    return replace(_searched(best, surface, frame, reach, USUAL_EFFORT, UNKNOWN_TINT), searched=True)


def _unmoved(surface: TrackedSurface, frame: RgbdFrame, T_cam_obj: Float64, tint: Tint) -> Step:
    """A pose as it is, with what it explains."""
    box, z = surface.box(T_cam_obj, frame.camera), float(surface.centre_cam(T_cam_obj)[2])
    region = None if box is None else prepare(frame, _with_margin(box, frame, z), z)
    fit = NOTHING if region is None else score(surface, region, T_cam_obj, 0, tint=tint)
    return Step(T_cam_obj, fit, np.zeros((6, 6)), "velocity")


def _scored(surface: TrackedSurface, region: Region, refined: Refined, start: str, tint: Tint) -> Step:
    fit = score(surface, region, refined.T_cam_obj, 0, tint=tint)
    return Step(refined.T_cam_obj, fit, refined.information, start)


def _moved_m(surface: TrackedSurface, T_a: Float64, T_b: Float64) -> float:
    """How far the object's centre and rim moved at most."""
    shift = float(np.linalg.norm(surface.centre_cam(T_a) - surface.centre_cam(T_b)))
    return shift + surface.radius_m * se3.rotation_angle(T_a, T_b)


def _searched(
    best: Step, surface: TrackedSurface, frame: RgbdFrame, reach: Reach, effort: Effort, tint: Tint
) -> Step:
    found = search(surface, frame, reach, effort, tint)
    return best if found is None else _better(best, best_of(surface, frame, [(found[0], "search")], tint))


def _better(a: Step, b: Step, by: float = 0.0) -> Step:
    return b if b.fit.total > a.fit.total + by else a


def _convincing(step: Step, usual: float | None, doubt: float) -> bool:
    total = step.fit.total
    allowed = doubt + HIDDEN_COSTS * step.fit.hidden
    return total >= DOUBTFUL_TOTAL and (usual is None or total >= usual - allowed)


def _union(*boxes: Box) -> Box:
    x0, y0 = min(b.x for b in boxes), min(b.y for b in boxes)
    x1, y1 = max(b.x1 for b in boxes), max(b.y1 for b in boxes)
    return Box(x0, y0, x1 - x0, y1 - y0)


def _with_margin(box: Box, frame: RgbdFrame, z: float) -> Box:
    return box.grown(0.0, max(8.0, MARGIN_M / max(z, 0.05) * frame.camera.fx))
