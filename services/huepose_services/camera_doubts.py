"""Detect a wrong camera matrix, depth scale or mesh size, and depth that is displaced from the colours,
from frames and poses.

Several looks (measurements) are combined, because a single one says little.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from functools import partial

from huepose.estimation.apparent_size import ApparentSize, doubted_camera, doubted_objects
from huepose.estimation.depth_offset import DepthOffset
from huepose.estimation.frame_offset import frame_offset
from huepose.estimation.types import PoseEstimate
from huepose.geometry import Camera, RgbdFrame
from huepose.geometry.arrays import Float64
from huepose.tracking.types import Key
from huepose_services.runtime.clock import SECOND

LOOKS, FEWEST_LOOKS = 12, 3
"""How many looks are kept (the newest count), and how many looks at sizes a doubt needs."""

LOOK_EVERY_NS, LATER_EVERY_NS = SECOND, 10 * SECOND
"""Time from one look at an object to the next. The first FEWEST_LOOKS follow each other at once.
LOOK_EVERY_NS holds for the first EARLY looks and while the camera or the object is doubted, LATER_EVERY_NS
else. For depth LOOK_EVERY_NS holds for the first LOOKS of a camera epoch. A look takes some 80 ms of a
processor."""

EARLY = 2 * FEWEST_LOOKS

GONE_NS = 10 * SECOND
"""There is no warning about an object that was not found for this long."""

WAY_OUT = "No pose is TRACKING because of this. If you are sure that all is right, set camera.check: false."

SizesSeen = Callable[[RgbdFrame, Sequence[PoseEstimate]], list[Float64]]
"""`Estimator.sizes_seen`."""

_Seen = defaultdict[Key, deque[Float64]]


class CameraDoubts:
    """The doubts about the camera of the last frame, and about the instances in its images."""

    def __init__(self, sizes_seen: SizesSeen) -> None:
        self._sizes_seen = sizes_seen
        self._camera: Camera | None = None
        self._size: ApparentSize | None = None
        self._objects: dict[Key, ApparentSize] = {}
        self._frames = self._next_ns = self._now_ns = 0
        self._begin(-1)

    def look(self, frame: RgbdFrame, answers: Sequence[PoseEstimate], at_ns: int) -> None:
        """If it is time, look at the depth of a frame, and at the size of one object for which there is an
        answer."""
        if frame.epoch != self._epoch:
            self._begin(frame.epoch)
        self._camera = frame.camera
        if at_ns >= self._next_ns:
            self._frames += 1
            self._next_ns = at_ns + (LOOK_EVERY_NS if self._frames < LOOKS else LATER_EVERY_NS)
            self._offsets.append(frame_offset(frame))
        # A false positive is often background that looks like the object in another size: new instances are
        # left out.
        followed = [answer for answer in answers if answer.found and answer.instance >= 0]
        self._now_ns = at_ns
        self._found_ns |= {_key(answer): at_ns for answer in followed}
        due = [answer for answer in followed if at_ns >= self._due_ns[_key(answer)]]
        if due:
            self._look_at(frame, min(due, key=lambda answer: self._looks[_key(answer)]), at_ns)

    def forget(self, name: str) -> None:
        """Drop the looks at an object: it was reset, or has another model."""
        for key in [key for key in self._found_ns if key[0] == name]:
            del self._found_ns[key]
            for looks in (self._sure, self._doubtful):
                looks.pop(key, None)
            for number in (self._looks, self._due_ns):
                number.pop(key, None)
        self._judge()

    def _look_at(self, frame: RgbdFrame, answer: PoseEstimate, at_ns: int) -> None:
        key = _key(answer)
        seen = self._sure if answer.state == "TRACKING" else self._doubtful
        seen[key] += self._sizes_seen(frame, [answer])
        self._looks[key] += 1
        self._judge()
        if self._looks[key] >= FEWEST_LOOKS:
            soon = self._looks[key] < EARLY or self._size is not None or key in self._objects
            self._due_ns[key] = at_ns + (LOOK_EVERY_NS if soon else LATER_EVERY_NS)

    def _judge(self) -> None:
        """Decide from all looks whether to doubt the camera, or else single objects."""
        # If an object has too few looks at TRACKING poses, those at doubtful poses count, too.
        each = dict(self._sure)
        for k, doubtful in self._doubtful.items():
            if len(self._sure[k]) < FEWEST_LOOKS:
                each[k] = deque([*self._sure[k], *doubtful])
        enough = sum(map(len, self._sure.values())) >= FEWEST_LOOKS
        size = doubted_camera(self._sure if enough else each, FEWEST_LOOKS)
        self._size, self._objects = size, {} if size else doubted_objects(each, FEWEST_LOOKS)

    @property
    def offset(self) -> str:
        """How depth is displaced from the colours in most of the looks; empty if it is not."""
        found = [offset for offset in self._offsets if offset is not None]
        return found[-1].said() if 2 * len(found) > len(self._offsets) else ""

    @property
    def text(self) -> str:
        """What is wrong with the camera; empty if nothing is."""
        if self._size is None or self._camera is None:
            return self.offset
        return self.offset or self._size.said(self._camera)

    @property
    def objects(self) -> dict[Key, str]:
        """What is wrong with single instances that were found lately; only those with a fault."""
        here = [key for key in self._objects if self._now_ns - self._found_ns[key] < GONE_NS]
        return {key: self._objects[key].said_of_one() for key in here}

    def of(self, name: str, instance: int | None) -> str:
        """What is wrong with an instance that was found lately; empty if nothing is. For a new instance
        (None): what is wrong with any instance of that name."""
        texts = [text for key, text in self.objects.items() if key[0] == name and instance in (None, key[1])]
        return texts[0] if texts else ""

    def _begin(self, epoch: int) -> None:
        self._epoch = epoch
        self._frames = self._next_ns = 0
        self._offsets: deque[DepthOffset | None] = deque(maxlen=LOOKS)
        self._sure: _Seen = defaultdict(partial(deque, maxlen=LOOKS))
        self._doubtful: _Seen = defaultdict(partial(deque, maxlen=LOOKS))
        self._looks: defaultdict[Key, int] = defaultdict(int)
        self._due_ns: defaultdict[Key, int] = defaultdict(int)
        self._found_ns: dict[Key, int] = {}
        self._size, self._objects = None, {}


def _key(answer: PoseEstimate) -> Key:
    return answer.object, answer.instance
