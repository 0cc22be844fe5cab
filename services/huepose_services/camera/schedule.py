"""When the frames of a source are due, pass after pass: absolute times, so that nothing drifts.
And whether this computer is too busy for them: late once means nothing, again and again it does."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

from huepose.datasets.types import Scene
from huepose_services.runtime.clock import SECOND
from huepose_services.runtime.config_perception import CameraConfig

_LONGEST_GAP_NS = 10 * SECOND


_WINDOW_NS = 60 * SECOND

_OFTEN = 3


class Schedule:
    """When each frame of a source is due, pass after pass.

    Frame `index` counts all frames since the start; image_ids are those of one pass."""

    def __init__(self, source: Scene, camera: CameraConfig, start_ns: int) -> None:
        self._ids = source.image_ids
        self._id_step = max(self._ids) + 1
        self._once = camera.once
        self._start_ns = start_ns
        if camera.rate == "recorded":
            stamps = [source.stamp_ns(i) for i in self._ids]
            gaps = [min(max(b - a, 0), _LONGEST_GAP_NS) for a, b in pairwise(stamps)]
            usual = sorted(gaps)[len(gaps) // 2] if gaps else SECOND // 30
            self._offsets = [0]
            for gap in [*gaps, usual]:
                self._offsets.append(self._offsets[-1] + gap)
        else:
            period = SECOND / float(camera.rate)
            self._offsets = [round(i * period) for i in range(len(self._ids) + 1)]

    def image(self, index: int) -> int | None:
        """The image of a frame; None after the last."""
        if self._once and index >= len(self._ids):
            return None
        return self._ids[index % len(self._ids)]

    def frame_id(self, index: int) -> int:
        """The image's number on the first pass; the same and a multiple of the length on later ones."""
        return self._ids[index % len(self._ids)] + index // len(self._ids) * self._id_step

    def due_ns(self, index: int) -> int:
        """The time at which a frame is due."""
        passes, place = divmod(index, len(self._ids))
        return self._start_ns + passes * self._offsets[-1] + self._offsets[place]

    def postpone(self, by_ns: int) -> None:
        """Move everything that is still to come."""
        self._start_ns += by_ns


class Busy:
    """Counts how often the camera was late in the last minute."""

    def __init__(self) -> None:
        self._late: deque[tuple[int, int]] = deque()

    def late(self, by_ns: int, now_ns: int) -> str:
        """The camera is late; the line for the log."""
        self._late.append((now_ns, by_ns))
        return f"frames come {by_ns * 1e-6:.0f} ms late: this computer is busy"

    def warning(self, now_ns: int) -> str | None:
        """What is to be said as long as it is so; None when all is well."""
        while self._late and now_ns - self._late[0][0] > _WINDOW_NS:
            self._late.popleft()
        if len(self._late) < _OFTEN:
            return None
        worst_ms = max(by_ns for _, by_ns in self._late) * 1e-6
        return (
            f"this computer is busy: the camera was late {len(self._late)} times in the last minute, by up "
            f"to {worst_ms:.0f} ms; end other programs, or set camera.rate lower"
        )
