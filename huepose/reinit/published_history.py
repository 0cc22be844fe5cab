"""Published poses of every instance in the last seconds.

An answer of perception is about a past frame. A velocity is too inaccurate to extrapolate over that time, so
the pose at that frame is looked up.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from huepose.geometry import se3
from huepose.geometry.se3 import grown
from huepose.reinit.schedule import LONGEST_S
from huepose.reinit.types import Key, Prior
from huepose.tracking.types import TrackedPose


class PublishedHistory:
    """The newest published poses of every instance."""

    def __init__(self) -> None:
        self._poses: dict[Key, deque[Prior]] = {}

    def note(self, track: TrackedPose) -> None:
        """Remember a published pose, if it is one and newer than the last."""
        past = self._poses.setdefault(track.key, deque())
        if track.T_cam_obj is not None and (not past or past[-1].stamp_ns < track.stamp_ns):
            past.append(_prior(track))
            while past[-1].stamp_ns - past[0].stamp_ns > LONGEST_S * 1e9:
                past.popleft()

    def forget(self, name: str) -> None:
        """Nothing was published of the instances of an object."""
        for key in [k for k in self._poses if k[0] == name]:
            del self._poses[key]

    def clear(self) -> None:
        """Nothing was published of anything."""
        self._poses.clear()

    def at(self, track: TrackedPose, stamp_ns: int) -> Prior:
        """The published pose of a track at a stamp, or nearest to it. Between two poses it is interpolated;
        its covariance is that of the nearer one, grown over the time in between. Raises ValueError for a
        track without a pose."""
        known: list[Prior] = [*self._poses.get(track.key, ()), _prior(track)]
        nearest = known[int(np.argmin([abs(p.stamp_ns - stamp_ns) for p in known]))]
        before = [p for p in known if p.stamp_ns < stamp_ns]
        after = [p for p in known if p.stamp_ns > stamp_ns]
        if nearest.stamp_ns == stamp_ns or not before or not after:
            return nearest
        a, b = max(before, key=lambda p: p.stamp_ns), min(after, key=lambda p: p.stamp_ns)
        share = (stamp_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns)
        T = se3.interpolate(a.T_cam_obj, b.T_cam_obj, share)
        covariance = nearest.covariance
        if covariance is not None:
            covariance = grown(covariance, abs(nearest.stamp_ns - stamp_ns) * 1e-9)
        return Prior(T, nearest.velocity, covariance, stamp_ns)


def _prior(track: TrackedPose) -> Prior:
    if track.T_cam_obj is None:
        raise ValueError(f"{track.object}/{track.instance} has no pose")
    return Prior(track.T_cam_obj, track.velocity, track.covariance, track.stamp_ns)
