"""Catching up: a late pose that increments cannot carry is tracked through the kept frames until it reaches
now.

That is the case for an object that had no pose, and for a gross correction, whose increments were measured on
the wrong surface. Nothing is published on the way. Frames are skipped so that it ends: the frames that are
left are halved with every step, up to a stride that the tracker's search still bridges. Where frames were
kept farther apart than that, it goes from one to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.propose.relative_pose import RelativePose
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.motion import filtered, increment_velocity
from huepose.tracking.scoring import UNKNOWN_TINT, Tint
from huepose.tracking.step import Anchor, Step, Subject, advance, found_nearby
from huepose.tracking.types import Correction

FITS = 0.5
"""Frames that support the pose by at least this much teach what is usual."""

SLACK = 1.5
"""Frames do not come to the millisecond."""


@dataclass(frozen=True, eq=False)
class Pursuit:
    """A correction on its way to now: the newest frame that it has reached (None before the first), its pose
    and velocity there, how it got there, and the kept frames that it went through.

    usual: the score that is usual for the object, at first from before it was lost; tint of its light;
    evidence: probability that the pose is still the one that was corrected to."""

    correction: Correction
    T_cam_obj: Float64
    reached: RgbdFrame | None = None
    velocity: Float64 | None = None
    step: Step | None = None
    poses: tuple[tuple[int, Float64], ...] = ()
    usual: float | None = None
    tint: Tint = UNKNOWN_TINT
    evidence: float = 0.0

    @staticmethod
    def of(correction: Correction, usual: float | None = None) -> Pursuit:
        """Before its first step."""
        return Pursuit(correction, correction.T_cam_obj, usual=usual, evidence=correction.quality)

    def arrived(self, newest: RgbdFrame) -> bool:
        """Whether it has reached that frame."""
        return self.reached is not None and self.reached.stamp_ns >= newest.stamp_ns

    def supported(self, config: TrackerConfig) -> bool:
        """Whether no frame on the way spoke against it. What was hidden on the way was not followed: what
        is found behind that, on the surface that hides it, is something else."""
        return self.evidence >= config.lost_quality


def pursue(
    pursuit: Pursuit,
    subject: Subject,
    kept: Sequence[RgbdFrame],
    config: TrackerConfig,
    relative_pose: RelativePose | None = None,
) -> Pursuit:
    """One step towards the newest of the kept frames (oldest first, none before the correction's)."""
    mask = None
    if pursuit.reached is None:
        # Settled on its own frame first, or on the one next to it: so it is known how well it should fit.
        first = kept[0]
        if first.stamp_ns == pursuit.correction.stamp_ns:
            mask = pursuit.correction.mask
        apart_s = abs(first.stamp_ns - pursuit.correction.stamp_ns) * 1e-9
        step = found_nearby(subject.surface, pursuit.T_cam_obj, first, apart_s, config)
        pursuit = _reached(pursuit, first, step, None)
        if first is kept[-1] or not pursuit.supported(config):
            return pursuit
    assert pursuit.reached is not None
    anchor = Anchor(
        pursuit.T_cam_obj, pursuit.velocity, pursuit.reached, pursuit.usual, pursuit.tint, mask=mask
    )
    frame = _next(anchor.frame, kept, config.catch_up_stride)
    step = advance(subject, anchor, frame, config, relative_pose)
    sure = evidence.quality(step.fit, pursuit.usual, pursuit.evidence)
    if step.near is not None and sure < config.suspect_quality:
        # What is found somewhere else and not believed is something else.
        step = replace(step.near, searched=step.searched)
    seconds = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9
    measured = increment_velocity(anchor.T_cam_obj, step.T_cam_obj, seconds)
    return _reached(pursuit, frame, step, filtered(pursuit.velocity, measured, seconds))


def needs_search(pursuit: Pursuit, kept: Sequence[RgbdFrame], config: TrackerConfig) -> bool:
    """Whether the next step leads to a frame so far off that it cannot do without a search."""
    if pursuit.reached is None:
        apart_ns = abs(kept[0].stamp_ns - pursuit.correction.stamp_ns)
        reached = kept[0]
    else:
        apart_ns, reached = 0, pursuit.reached
    if reached is not kept[-1]:
        ahead = _next(reached, kept, config.catch_up_stride)
        apart_ns = max(apart_ns, ahead.stamp_ns - reached.stamp_ns)
    usual_ns = config.catch_up_stride * _interval_ns(kept, config.catch_up_stride)
    return config.search and apart_ns > SLACK * usual_ns


def _next(reached: RgbdFrame, kept: Sequence[RgbdFrame], stride: int) -> RgbdFrame:
    """The kept frame to go to: with half of those that are left skipped, and no more time than `stride`
    frames take; at least one frame on."""
    ahead = [f for f in kept if f.stamp_ns > reached.stamp_ns]
    count = min(len(ahead), stride, max(1, (len(ahead) + 1) // 2 + 1))
    limit_ns = SLACK * stride * _interval_ns(kept, stride)
    while count > 1 and ahead[count - 1].stamp_ns - reached.stamp_ns > limit_ns:
        count -= 1
    return ahead[count - 1]


def _interval_ns(kept: Sequence[RgbdFrame], count: int) -> float:
    """The usual time between the newest frames, none of which was left out."""
    stamps = [f.stamp_ns for f in kept[-count - 1 :]]
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0


def _reached(pursuit: Pursuit, frame: RgbdFrame, step: Step, velocity: Float64 | None) -> Pursuit:
    sure = evidence.quality(step.fit, pursuit.usual, pursuit.evidence)
    usual, tint = pursuit.usual, pursuit.tint
    # What was usual before it was lost is asked for again: a pose that fits worse must not make that usual.
    if sure >= FITS and (usual is None or step.fit.total >= usual):
        usual, tint = evidence.usual_after(usual, step.fit.total), evidence.tint_after(tint, step.fit.tint)
    return replace(
        pursuit,
        T_cam_obj=step.T_cam_obj,
        reached=frame,
        velocity=velocity,
        step=step,
        poses=(*pursuit.poses, (frame.stamp_ns, step.T_cam_obj)),
        usual=usual,
        tint=tint,
        evidence=sure,
    )
