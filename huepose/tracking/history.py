"""What a tracker remembers, so that a late result can still be of use: frames, and poses at their frames.

ROFT (Piga et al. 2022) buffers velocities and replays them on a late pose; here the increments between
buffered poses are replayed, which is the same without integrating anything. An increment is a motion of the
scene in camera axes, `T_j inverse(T_i)`: it stays right when the pose that it was measured on was wrong by a
turn of the object in itself.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame


@dataclass(frozen=True, eq=False)
class Entry:
    """A frame and the pose (4, 4) in it, None where there was none."""

    frame_id: int
    stamp_ns: int
    T_cam_obj: Float64 | None


class PoseHistory:
    """The poses of one object at the newest frames, oldest first."""

    def __init__(self, length: int) -> None:
        self._entries: deque[Entry] = deque(maxlen=length)

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

    def covers(self, stamp_ns: int) -> bool:
        """Whether a stamp lies between the oldest and the newest entry."""
        return bool(self._entries) and self._entries[0].stamp_ns <= stamp_ns <= self._entries[-1].stamp_ns

    def at(self, stamp_ns: int) -> Float64 | None:
        """The pose at a stamp: that of its frame, or, where that frame was skipped, interpolated on SE(3)
        between its neighbours. None outside of the history, and where a needed pose is missing."""
        before: Entry | None = None
        for entry in self._entries:
            if entry.stamp_ns == stamp_ns:
                return entry.T_cam_obj
            if entry.stamp_ns > stamp_ns:
                if before is None or before.T_cam_obj is None or entry.T_cam_obj is None:
                    return None
                share = (stamp_ns - before.stamp_ns) / (entry.stamp_ns - before.stamp_ns)
                return se3.interpolate(before.T_cam_obj, entry.T_cam_obj, share)
            before = entry
        return None

    def unbroken_since(self, stamp_ns: int) -> bool:
        """Whether every entry at or after a stamp has a pose."""
        return all(e.T_cam_obj is not None for e in self._entries if e.stamp_ns >= stamp_ns)

    def replay(self, stamp_ns: int, T_cam_obj: Float64) -> Float64:
        """Replace the pose at a stamp and carry the correction to now by the buffered increments; the kept
        poses since then are replaced as well. Returns the newest pose.

        Raises ValueError where `at` gives nothing or the history since is broken.
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
        """Set the pose of a kept frame; nothing happens where none has that stamp."""
        for k, entry in enumerate(self._entries):
            if entry.stamp_ns == stamp_ns:
                self._entries[k] = Entry(entry.frame_id, stamp_ns, T_cam_obj)


class FrameHistory:
    """The newest frames of one camera epoch, oldest first."""

    def __init__(self, length: int) -> None:
        self._frames: deque[RgbdFrame] = deque(maxlen=length)

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def newest(self) -> RgbdFrame | None:
        """The last frame."""
        return self._frames[-1] if self._frames else None

    def append(self, frame: RgbdFrame) -> None:
        """Add the newest frame."""
        self._frames.append(frame)

    def clear(self) -> None:
        """Forget all."""
        self._frames.clear()

    def covers(self, stamp_ns: int) -> bool:
        """Whether a stamp is not older than the oldest kept frame."""
        return bool(self._frames) and self._frames[0].stamp_ns <= stamp_ns

    def since(self, stamp_ns: int) -> list[RgbdFrame]:
        """Frames at or after a stamp, oldest first."""
        return [f for f in self._frames if f.stamp_ns >= stamp_ns]
