"""The input log of the tracker worker: all that a step depends on, so that `huepose replay --verify` can
compute the poses of a recording again.

A step logs changes of the object list, corrections, the frame's number and every clock reading, and a
checksum of the tracker's memory after each stage. The memory itself (MemoryMessage) is published every few
seconds. Checksums and the memory are computed only while somebody records.
"""

from __future__ import annotations

import weakref
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

import zenoh

from huepose.geometry import RgbdFrame
from huepose.support.stages import StageClock, listening
from huepose.tracking import Tracker
from huepose.tracking.memory import checksum
from huepose_protos import WireError, decode, encode
from huepose_protos.messages import (
    AgainRequest,
    CorrectionMessage,
    FrameHeader,
    IntakeMessage,
    ObjectChange,
    StageMark,
)
from huepose_services.convert import frame_key
from huepose_services.following import Change
from huepose_services.runtime.bus import Bus, bytes_of
from huepose_services.runtime.clock import SECOND, now_ns

MEMORY_EVERY_NS = 5 * SECOND
"""How often the tracker's memory is published. A recording can be verified from the first memory on for
which it has all frames."""

Clock = Callable[[], int]
Action = Literal["add", "remove", "reset"]


@dataclass
class Intake:
    """The log of one step. recorded: whether somebody records; else no checksums are computed."""

    clock: Clock = now_ns
    recorded: bool = False
    clock_ns: list[int] = field(default_factory=list)
    changes: list[ObjectChange] = field(default_factory=list)
    corrections: list[CorrectionMessage] = field(default_factory=list)
    frame: FrameHeader | None = None
    marks: list[StageMark] = field(default_factory=list)

    def now(self) -> int:
        """Read the clock, and log the reading."""
        self.clock_ns.append(self.clock())
        return self.clock_ns[-1]

    def change(self, change: Change) -> None:
        """Log an object that was added, removed, or reset."""
        action: Action = "remove" if change.removed else "reset" if change.added is None else "add"
        self.changes.append(ObjectChange(action=action, entry=change.entry))

    @property
    def empty(self) -> bool:
        """Whether the step had no input."""
        return not (self.changes or self.corrections or self.frame or self.clock_ns)

    def mark(self, stage: str, tracker: Tracker) -> None:
        """Log a checksum of the tracker's memory after a stage."""
        if self.recorded:
            self.marks.append(StageMark(stage=stage, checksum=checksum(tracker)))

    @contextmanager
    def stages(self, tracker: Tracker) -> Iterator[None]:
        """Call `mark` after each stage of the library that runs inside the block."""
        if not self.recorded:
            yield
            return
        with listening(_Marking(self, tracker)):
            yield

    def message(self, seq: int) -> IntakeMessage:
        """The message of this step."""
        frame = self.frame
        return IntakeMessage(
            publish_ns=now_ns(),
            seq=seq,
            clock_ns=self.clock_ns,
            changes=self.changes,
            corrections=self.corrections,
            camera_epoch=None if frame is None else frame.camera_epoch,
            frame_id=None if frame is None else frame.frame_id,
            marks=self.marks,
        )


class _Marking(StageClock):
    def __init__(self, intake: Intake, tracker: Tracker) -> None:
        super().__init__()
        self._intake, self._tracker = intake, tracker

    def ended(self, name: str, wall_s: float, cpu_s: float) -> None:
        self._intake.mark(name, self._tracker)


_NEWEST_BYTES = 96 * 1024 * 1024
"""Two seconds at 640 x 480 and 30 Hz: a busy recorder finds out in that time which frames it has lost."""
_STEPS = 512


class InputCache:
    """Recent inputs of the tracker, which a recorder can request again (AgainRequest). A recorder that is
    behind loses frames, and a recording without every frame that the tracker took cannot be verified.

    A frame is kept as long as the tracker keeps it, which costs no memory because the pixels are shared;
    while somebody records, the newest frames are kept too."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._frames: dict[tuple[int, int], tuple[FrameHeader, bytes]] = {}
        self._newest: deque[RgbdFrame] = deque()
        self._newest_bytes = 0
        self._steps: deque[IntakeMessage] = deque(maxlen=_STEPS)
        bus.inbox.serve(bus.keys.again, self._answer)

    def frame(self, header: FrameHeader, payload: bytes, frame: RgbdFrame, recorded: bool) -> None:
        """Keep a frame that the tracker took. recorded: whether somebody records."""
        key = frame_key(header)
        if key in self._frames:
            return
        self._frames[key] = (header, payload)
        # The tracker may keep a copy of the frame with a camera pose: copies share the colour image.
        weakref.finalize(frame.color, self._frames.pop, key, None).atexit = False
        self._newest.append(frame)
        self._newest_bytes += len(payload)
        while self._newest and self._newest_bytes > (_NEWEST_BYTES if recorded else 0):
            oldest = self._newest.popleft()
            self._newest_bytes -= len(self._frames[oldest.epoch, oldest.frame_id][1])

    def step(self, message: IntakeMessage) -> None:
        """Keep the log of a step."""
        self._steps.append(message)

    def _answer(self, query: zenoh.Query) -> None:
        try:
            request = decode(bytes_of(query.payload), AgainRequest)
        except WireError as error:
            self._bus.refuse(self._bus.keys.again, error)
            return
        # All other messages go first.
        low_priority: dict[str, Any] = {
            "congestion_control": zenoh.CongestionControl.BLOCK,
            "priority": zenoh.Priority.DATA_LOW,
        }
        steps = set(request.steps)
        for message in list(self._steps):
            if message.seq in steps:
                query.reply(self._bus.keys.again, encode(message), **low_priority)
        for key in request.frames:
            if (found := self._frames.get(key)) is not None:
                query.reply(self._bus.keys.again, found[1], attachment=encode(found[0]), **low_priority)
