"""What pictures and poses say against a camera: sizes that do not fit its matrix, depth beside the colours.

A few looks, some time apart, since none of them is worth much alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from huepose.estimation.apparent_size import apparent_size
from huepose.estimation.depth_offset import DepthOffset
from huepose.estimation.frame_offset import frame_offset
from huepose.estimation.types import PoseEstimate
from huepose.geometry import Camera, RgbdFrame
from huepose.geometry.arrays import Float64
from huepose_services.runtime.clock import SECOND

LOOKS, FEWEST_LOOKS = 12, 3
"""Newest looks that count, and how many looks at sizes are asked for a doubt."""

LOOK_EVERY_NS, LATER_EVERY_NS = SECOND, 10 * SECOND
"""From one look to the next, for the first LOOKS of an epoch of the camera and after them. One takes some 80
ms of a processor."""

WAY_OUT = "No pose is TRACKING for it. If you are sure that all is right, set camera.check: false."

SizesSeen = Callable[[RgbdFrame, Sequence[PoseEstimate]], list[Float64]]
"""`Estimator.sizes_seen`."""


class CameraDoubts:
    """Of the camera whose pictures were looked at last."""

    def __init__(self, sizes_seen: SizesSeen) -> None:
        self._sizes_seen = sizes_seen
        self._camera: Camera | None = None
        self._looks = self._next_ns = 0
        self._begin(-1)

    def look(self, frame: RgbdFrame, answers: Sequence[PoseEstimate], number: int, at_ns: int) -> None:
        """Look at a frame and one of the answers about it, where it is time. number: of the request."""
        if frame.epoch != self._epoch:
            self._begin(frame.epoch)
        if at_ns < self._next_ns:
            return
        self._looks += 1
        self._next_ns = at_ns + (LOOK_EVERY_NS if self._looks < LOOKS else LATER_EVERY_NS)
        self._camera = frame.camera
        self._offsets.append(frame_offset(frame))
        sure = [answer for answer in answers if answer.state == "TRACKING"]
        # Where nothing is, the background is often taken for an object of another size.
        followed = [answer for answer in answers if answer.state == "SUSPECT" and answer.instance >= 0]
        for mine, seen in ((sure, self._sure), (followed, self._doubtful)):
            if mine:
                seen += self._sizes_seen(frame, [mine[number % len(mine)]])

    @property
    def offset(self) -> str:
        """How depth lies beside the colours, in most of the looks; empty where it does not."""
        found = [offset for offset in self._offsets if offset is not None]
        return found[-1].said() if 2 * len(found) > len(self._offsets) else ""

    @property
    def size(self) -> str:
        """That objects are larger or smaller than they have to be; empty where they are not. Where sure
        poses are too few, those that are followed though doubtful are asked, too."""
        enough = len(self._sure) >= FEWEST_LOOKS
        seen = self._sure if enough else [*self._sure, *self._doubtful]
        size = apparent_size(seen)
        if self._camera is None or len(seen) < FEWEST_LOOKS or not size.clear:
            return ""
        return size.said(self._camera)

    @property
    def text(self) -> str:
        """What is wrong, empty where nothing is."""
        return self.offset or self.size

    def _begin(self, epoch: int) -> None:
        self._epoch, self._looks, self._next_ns = epoch, 0, 0
        self._offsets: deque[DepthOffset | None] = deque(maxlen=LOOKS)
        self._sure: deque[Float64] = deque(maxlen=LOOKS)
        self._doubtful: deque[Float64] = deque(maxlen=LOOKS)
