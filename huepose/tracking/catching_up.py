"""Catching up: a late pose that increments cannot carry is tracked through the kept frames until it reaches
now.

That is the case for an object that had no pose, and for a gross correction, whose increments were measured on
the wrong surface. Nothing is published on the way. Frames are skipped so that it ends: the frames that are
left are halved with every step, up to a stride that the tracker's search still bridges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.motion import filtered, increment_velocity
from huepose.tracking.relative_pose import RelativePose
from huepose.tracking.step import Anchor, Step, Subject, advance, best_of
from huepose.tracking.types import Correction


@dataclass(frozen=True, eq=False)
class Pursuit:
    """A correction on its way to now: the newest frame that it has reached (None before the first), its pose
    and velocity there, how it got there, and the kept frames that it went through."""

    correction: Correction
    T_cam_obj: Float64
    reached: RgbdFrame | None = None
    velocity: Float64 | None = None
    step: Step | None = None
    poses: tuple[tuple[int, Float64], ...] = ()

    @staticmethod
    def of(correction: Correction) -> Pursuit:
        """Before its first step."""
        return Pursuit(correction, correction.T_cam_obj)

    def arrived(self, newest: RgbdFrame) -> bool:
        """Whether it has reached that frame."""
        return self.reached is not None and self.reached.stamp_ns >= newest.stamp_ns


def pursue(
    pursuit: Pursuit,
    subject: Subject,
    kept: Sequence[RgbdFrame],
    config: TrackerConfig,
    relative_pose: RelativePose | None = None,
) -> Pursuit:
    """One step towards the newest of the kept frames (oldest first, none before the correction's)."""
    if pursuit.reached is None:
        first = kept[0]
        if first is kept[-1] or first.stamp_ns != pursuit.correction.stamp_ns:
            # Nothing to step over, or its own frame was skipped: settle on the frame next to it.
            step = best_of(subject.surface, first, [(pursuit.T_cam_obj, "correction")])
            return _reached(pursuit, first, step, None)
        anchor = Anchor(pursuit.T_cam_obj, None, first, None, mask=pursuit.correction.mask)
    else:
        anchor = Anchor(pursuit.T_cam_obj, pursuit.velocity, pursuit.reached, _usual(pursuit))
    ahead = [f for f in kept if f.stamp_ns > anchor.frame.stamp_ns]
    frame = ahead[min(len(ahead), config.catch_up_stride, max(1, (len(ahead) + 1) // 2 + 1)) - 1]
    step = advance(subject, anchor, frame, config, relative_pose)
    seconds = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9
    measured = increment_velocity(anchor.T_cam_obj, step.T_cam_obj, seconds)
    return _reached(pursuit, frame, step, filtered(pursuit.velocity, measured, seconds))


def _reached(pursuit: Pursuit, frame: RgbdFrame, step: Step, velocity: Float64 | None) -> Pursuit:
    poses = (*pursuit.poses, (frame.stamp_ns, step.T_cam_obj))
    return replace(
        pursuit, T_cam_obj=step.T_cam_obj, reached=frame, velocity=velocity, step=step, poses=poses
    )


def _usual(pursuit: Pursuit) -> float | None:
    return None if pursuit.step is None else pursuit.step.fit.total


def supported(pursuit: Pursuit, config: TrackerConfig) -> bool:
    """Whether the newest reached frame does not speak against its pose."""
    step = pursuit.step
    sure = pursuit.correction.quality
    return step is not None and evidence.quality(step.fit, None, sure) >= config.lost_quality
