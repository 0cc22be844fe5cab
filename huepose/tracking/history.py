"""What a tracker stores for late results: frames, and poses in their frames.

ROFT (Piga et al. 2022) buffers velocities and replays them on a late pose. Here the increments between
buffered poses are replayed, which is the same without integration. An increment is a motion of the scene in
camera axes, `T_j inverse(T_i)`: it stays right if the pose that it was measured on has a wrong orientation.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame

CLOSE_S, WIDE_S = 1.0 / 10.0, 1.0 / 6.0
"""Time between older frames: steps that the tracker takes without a search, and with one. Fast hands are
followed over every third and every fifth of thirty frames a second, but not over every ninth."""

NEARLY = 0.9
"""Tolerance: timestamps are not exact."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A frame and the pose (4, 4) in it, None without one."""

    frame_id: int
    stamp_ns: int
    T_cam_obj: Float64 | None


class PoseHistory:
    """The poses of one object in the newest frames, oldest first. middle_obj (3,): the object's middle,
    object axes."""

    def __init__(self, middle_obj: Float64) -> None:
        self._entries: deque[Entry] = deque()
        self._middle_obj = middle_obj

    def __iter__(self) -> Iterator[Entry]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def newest(self) -> Entry | None:
        """The last entry."""
        return self._entries[-1] if self._entries else None

    def append(self, frame_id: int, stamp_ns: int, T_cam_obj: Float64 | None) -> None:
        """Add the newest frame. Raises ValueError when it is not newer than the last."""
        if self._entries and stamp_ns <= self._entries[-1].stamp_ns:
            raise ValueError(f"frame {frame_id} at {stamp_ns} ns is not newer than the last one")
        self._entries.append(Entry(frame_id, stamp_ns, T_cam_obj))

    def forget_before(self, stamp_ns: int) -> None:
        """Delete older poses."""
        while self._entries and self._entries[0].stamp_ns < stamp_ns:
            self._entries.popleft()

    def at(self, stamp_ns: int) -> Float64 | None:
        """The pose at a timestamp: that of its frame, or, if that frame was skipped, interpolated between its
        neighbours, with the object's middle on a straight line. None outside of the history, and if a needed
        pose is missing."""
        before: Entry | None = None
        for entry in self._entries:
            if entry.stamp_ns == stamp_ns:
                return entry.T_cam_obj
            if entry.stamp_ns > stamp_ns:
                if before is None or before.T_cam_obj is None or entry.T_cam_obj is None:
                    return None
                share = (stamp_ns - before.stamp_ns) / (entry.stamp_ns - before.stamp_ns)
                return se3.interpolate(before.T_cam_obj, entry.T_cam_obj, share, self._middle_obj)
            before = entry
        return None

    def unbroken_since(self, stamp_ns: int) -> bool:
        """Whether every entry at or after a timestamp has a pose."""
        return all(e.T_cam_obj is not None for e in self._entries if e.stamp_ns >= stamp_ns)

    def replay(self, stamp_ns: int, T_cam_obj: Float64) -> Float64:
        """Replace the pose at a timestamp, and move the correction to the newest frame by the buffered
        increments; the stored poses since then are replaced as well. Returns the newest pose.

        Raises ValueError if `at` gives nothing or a pose since then is missing.
        """
        old = self.at(stamp_ns)
        if old is None or not self.unbroken_since(stamp_ns):
            raise ValueError(f"no unbroken history since {stamp_ns} ns")
        back = se3.inverse(old)
        for k, entry in enumerate(self._entries):
            if entry.stamp_ns >= stamp_ns and entry.T_cam_obj is not None:
                moved = se3.compose(entry.T_cam_obj, back, T_cam_obj)
                self._entries[k] = Entry(entry.frame_id, entry.stamp_ns, moved)
        newest = self._entries[-1].T_cam_obj
        assert newest is not None
        return newest

    def put(self, stamp_ns: int, T_cam_obj: Float64) -> None:
        """Set the pose of a stored frame; nothing happens if none has that timestamp."""
        for k, entry in enumerate(self._entries):
            if entry.stamp_ns == stamp_ns:
                self._entries[k] = Entry(entry.frame_id, stamp_ns, T_cam_obj)


class FrameHistory:
    """Frames of one camera epoch, fewer the older they are: all of the `newest` ones, before them `older`
    ones, half of them a tenth of a second apart, half a sixth. So few frames reach far back, and an estimate
    that is late by seconds can still be tracked to the newest frame."""

    def __init__(self, newest: int, older: int = 0) -> None:
        half = older // 2
        self._stretches = (_Stretch(newest, 0.0), _Stretch(older - half, CLOSE_S), _Stretch(half, WIDE_S))

    def __len__(self) -> int:
        return sum(len(stretch.frames) for stretch in self._stretches)

    def __iter__(self) -> Iterator[RgbdFrame]:
        return chain.from_iterable(stretch.frames for stretch in reversed(self._stretches))

    @property
    def newest(self) -> RgbdFrame | None:
        """The last frame."""
        frames = self._stretches[0].frames
        return frames[-1] if frames else None

    @property
    def oldest(self) -> RgbdFrame | None:
        """The oldest frame."""
        return next(iter(self), None)

    def append(self, frame: RgbdFrame) -> None:
        """Add the newest frame."""
        leaving: RgbdFrame | None = frame
        for stretch in self._stretches:
            if leaving is None:
                return
            leaving = stretch.taken(leaving)

    def clear(self) -> None:
        """Forget all."""
        for stretch in self._stretches:
            stretch.frames.clear()

    def covers(self, stamp_ns: int) -> bool:
        """Whether a timestamp is not older than the oldest stored frame."""
        oldest = self.oldest
        return oldest is not None and oldest.stamp_ns <= stamp_ns

    def since(self, stamp_ns: int) -> list[RgbdFrame]:
        """Frames at or after a timestamp, oldest first."""
        return [f for f in self if f.stamp_ns >= stamp_ns]

    def from_nearest(self, stamp_ns: int) -> list[RgbdFrame]:
        """The frame that is nearest to a timestamp, and all after it, oldest first."""
        nearest = min(self, key=lambda f: abs(f.stamp_ns - stamp_ns), default=None)
        return [] if nearest is None else self.since(nearest.stamp_ns)


class _Stretch:
    """Up to `most` frames that are at least `apart_s` apart, within a tolerance."""

    def __init__(self, most: int, apart_s: float) -> None:
        self.frames: deque[RgbdFrame] = deque()
        self._most, self._apart_ns = most, apart_s * NEARLY * 1e9

    def taken(self, frame: RgbdFrame) -> RgbdFrame | None:
        """Store a frame if the last one is far enough back. Returns the frame that has to leave, if any."""
        if not self._most:
            return frame
        if self.frames and frame.stamp_ns - self.frames[-1].stamp_ns < self._apart_ns:
            return None
        self.frames.append(frame)
        return self.frames.popleft() if len(self.frames) > self._most else None
