"""Catching up: a late pose that increments cannot move is tracked through the stored frames to the newest
one.

This is needed for an object that had no pose, and for a gross correction, since its increments were measured
on the wrong surface. Nothing is published on the way. Frames are skipped so that it ends: each step halves
the number of frames left, up to a stride that the tracker's search still bridges. If stored frames are
farther apart than that, it goes from one to the next.

The velocity of the object is not known at first. If a long step loses the object, the pursuit goes back,
takes the next frame, and then strides that grow as the velocity gets known. It is given up if the object is
lost again without progress, so it ends.

An object at rest is probably still at its place much later. It is looked for there as far ahead as nobody can
have turned it over meanwhile, and by strides only if it is not found there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.tracking.config import TrackerConfig
from huepose.tracking.lost import MORE, visible_share
from huepose.tracking.orientation import REST_S, at_rest
from huepose.tracking.subject import Subject
from huepose.tracking.track import Track
from huepose.tracking.types import Correction
from huepose.tracking.usual import Usual

SLACK = 1.5
"""Tolerance: frames do not come to the millisecond."""

STATIC_M, STATIC_RAD = 0.002, np.radians(0.3)
"""A camera that has moved by no more is static: three standard deviations of the assumed noise of a given
camera pose, 0.5 mm and 0.09 degrees per axis."""


class Pursuit:
    """A correction on its way to the newest frame: a track of its own, and the poses (timestamp, T_cam_obj)
    that it went through.

    before: the track of the object until now; it gives the usual total and the light, and of poses that look
    the same the one that is followed. turned_away: the camera motion is known, and the camera does not show
    the object's last place any more; the track is that of the last frame that showed it."""

    def __init__(
        self, correction: Correction, subject: Subject, config: TrackerConfig, before: Track | None = None
    ) -> None:
        if before is not None:
            correction = replace(correction, T_cam_obj=before.as_followed(correction))
        self.correction = correction
        self.track = Track(subject, correction.object, correction.instance, config)
        if before is not None:
            believed = before.belief
            usual = believed.usual.remembered(believed.gone_s(correction.stamp_ns))
            self.track.belief.usual = Usual(usual.baseline, usual.sure_light)
        self.poses: list[tuple[int, Float64]] = []
        self._config, self._stride = config, config.catch_up_stride
        self._lost_behind = np.inf
        self._rests = self.turned_away = False

    def arrived(self, newest: RgbdFrame) -> bool:
        """Whether it has reached that frame."""
        reached = self.track.frame
        return reached is not None and reached.stamp_ns >= newest.stamp_ns

    @property
    def supported(self) -> bool:
        """Whether the last frame supports the pose. An object that was occluded on the way was not followed:
        a pose found there afterwards, on the surface of the occluder, is of something else."""
        return self.track.belief.evidence >= self._config.lost_quality

    def follow(self, kept: Sequence[RgbdFrame], tries: float = np.inf) -> float:
        """One step towards the newest of the stored frames (oldest first, none before the correction's).
        Returns how many of at most `tries` costly proposals it used."""
        tried = 0.0
        if self.track.frame is None:
            # Refine it first in its own frame or the nearest one: that shows how well it should fit.
            first = kept[0]
            tried = self.track.start(self.correction, first)
            self._remember(first)
            if first is kept[-1] or not self.supported:
                return tried
        before, reached = self.track.copy(), self.track.frame
        assert reached is not None
        ahead, frame = _ahead(reached, kept), self._following(reached, kept)
        T_static = before.pose_if_static(frame)
        assert T_static is not None
        tried += self.track.look(frame, 0.0 if self._rests else tries - tried)
        if self.supported:
            self._stride = min(self._stride + 1, self._config.catch_up_stride)
            T = self.track.T_cam_obj
            self._rests = T is not None and at_rest(self.track.subject, T_static, T)
            self.track.learn()
            self._remember(frame)
        elif _camera_moved(reached, frame) and visible_share(before.subject.surface, T_static, frame) <= MORE:
            self.track, self.turned_away = before, True
        elif self._rests:
            self.track, self._rests = before, False
        elif frame is not ahead[0] and len(ahead) < self._lost_behind:
            self.track, self._stride, self._lost_behind = before, 1, len(ahead)
        return tried

    def needs_search(self, kept: Sequence[RgbdFrame]) -> bool:
        """Whether the next frame to go to is so far ahead that a search is needed."""
        apart_ns, reached = 0, self.track.frame
        if reached is None:
            apart_ns, reached = abs(kept[0].stamp_ns - self.correction.stamp_ns), kept[0]
        if reached is not kept[-1] and not self._rests:
            following = _next(reached, kept, self._stride)
            apart_ns = max(apart_ns, following.stamp_ns - reached.stamp_ns)
        normal_ns = self._config.catch_up_stride * _interval_ns(kept, self._config.catch_up_stride)
        return apart_ns > SLACK * normal_ns

    def _following(self, reached: RgbdFrame, kept: Sequence[RgbdFrame]) -> RgbdFrame:
        """The stored frame to go to."""
        if not self._rests:
            return _next(reached, kept, self._stride)
        ahead = _ahead(reached, kept)
        soon = [f for f in ahead if f.stamp_ns - reached.stamp_ns <= REST_S * 1e9]
        return soon[-1] if soon else ahead[0]

    def _remember(self, frame: RgbdFrame) -> None:
        T = self.track.T_cam_obj
        if T is not None:
            self.poses.append((frame.stamp_ns, T))


def _camera_moved(before: RgbdFrame, frame: RgbdFrame) -> bool:
    """Whether the camera is known to have moved from one frame to the other."""
    T, T_now = before.T_parent_cam, frame.T_parent_cam
    if T is None or T_now is None:
        return False
    shifted_m, turned_rad = se3.length(T_now[:3, 3] - T[:3, 3]), se3.rotation_angle(T, T_now)
    return bool(shifted_m > STATIC_M or turned_rad > STATIC_RAD)


def _next(reached: RgbdFrame, kept: Sequence[RgbdFrame], stride: int) -> RgbdFrame:
    """The stored frame to go to: it skips half of those that are left, and no more time than `stride` frames
    take; at least one frame ahead."""
    ahead = _ahead(reached, kept)
    count = min(len(ahead), stride, max(1, (len(ahead) + 1) // 2 + 1))
    limit_ns = SLACK * stride * _interval_ns(kept, stride)
    while count > 1 and ahead[count - 1].stamp_ns - reached.stamp_ns > limit_ns:
        count -= 1
    return ahead[count - 1]


def _ahead(reached: RgbdFrame, kept: Sequence[RgbdFrame]) -> list[RgbdFrame]:
    """The stored frames after one."""
    return [f for f in kept if f.stamp_ns > reached.stamp_ns]


def _interval_ns(kept: Sequence[RgbdFrame], count: int) -> float:
    """The median time between the newest frames, of which none was left out."""
    stamps = [f.stamp_ns for f in kept[-count - 1 :]]
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
