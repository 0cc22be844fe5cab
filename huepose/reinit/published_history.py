"""Published poses of every instance in the last seconds.

An answer of perception is about a past frame. A velocity is too inaccurate to extrapolate that far, so the
pose at that frame is looked up.
"""

from __future__ import annotations

from collections import deque

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.reinit.schedule import LONGEST_S
from huepose.reinit.types import Prior
from huepose.tracking.types import Key, TrackedPose


class PublishedHistory:
    """The newest published poses of every instance, and when it had none."""

    def __init__(self) -> None:
        self._poses: dict[Key, deque[tuple[int, Prior | None]]] = {}

    def note(self, track: TrackedPose) -> None:
        """Remember a published pose, or that there is none, if it is newer than the last."""
        past = self._poses.setdefault(track.key, deque())
        if not past or past[-1][0] < track.stamp_ns:
            past.append((track.stamp_ns, None if track.T_cam_obj is None else _prior(track)))
            while past[-1][0] - past[0][0] > LONGEST_S * 1e9:
                past.popleft()

    def forget(self, name: str) -> None:
        """Forget the instances of an object."""
        for key in [k for k in self._poses if k[0] == name]:
            del self._poses[key]

    def clear(self) -> None:
        """Forget everything."""
        self._poses.clear()

    def at(self, track: TrackedPose, stamp_ns: int, middle_obj: Float64) -> Prior:
        """The published pose of a track at a timestamp. Between two poses it is interpolated, with the
        object's middle (3,) on a straight line; the covariance is that of the nearer one, grown over the time
        in between. Where the track had no pose it is the next one; before the first it is the first, after
        the last the last. Raises ValueError for a track without a pose."""
        newest = _prior(track)
        known: list[tuple[int, Prior | None]] = [*self._poses.get(track.key, ()), (track.stamp_ns, newest)]
        before = [pose for at_ns, pose in known if at_ns <= stamp_ns]
        after = [pose for at_ns, pose in known if at_ns > stamp_ns]
        a, b = before[-1] if before else None, after[0] if after else None
        if a is None:
            return next((pose for pose in after if pose is not None), newest)
        if b is None or a.stamp_ns == stamp_ns:
            return a
        share = (stamp_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns)
        T = se3.interpolate(a.T_cam_obj, b.T_cam_obj, share, middle_obj)
        nearest = a if share <= 0.5 else b
        return Prior(T, nearest.velocity, nearest.covariance_at(stamp_ns, middle_obj), stamp_ns)


def _prior(track: TrackedPose) -> Prior:
    if track.T_cam_obj is None:
        raise ValueError(f"{track.object}/{track.instance} has no pose")
    return Prior(track.T_cam_obj, track.velocity, track.covariance, track.stamp_ns)
