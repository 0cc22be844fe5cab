"""What the tracker worker takes in, step by step, so that its poses can be computed again from a recording.

Objects that came and went, corrections, which frame, and each time that it read a clock; beside them a
checksum of what it believes after each stage, and now and then all that it believes. Costs nothing until
somebody listens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

from huepose.support.stages import StageClock, listening
from huepose.tracking import Tracker
from huepose.tracking.memory import checksum
from huepose_protos.messages import CorrectionMessage, FrameHeader, IntakeMessage, ObjectChange, StageMark
from huepose_services.following import Change
from huepose_services.runtime.clock import SECOND, now_ns

MEMORY_EVERY_NS = 5 * SECOND
"""How often all that is believed is told. A recording is computed again from the first time on at which it
has all frames that are remembered then."""

Clock = Callable[[], int]
Action = Literal["add", "remove", "reset"]


@dataclass
class Intake:
    """One step. heard: whether anybody listens, so that checksums are worth their time."""

    clock: Clock = now_ns
    heard: bool = False
    clock_ns: list[int] = field(default_factory=list)
    changes: list[ObjectChange] = field(default_factory=list)
    corrections: list[CorrectionMessage] = field(default_factory=list)
    frame: FrameHeader | None = None
    marks: list[StageMark] = field(default_factory=list)

    def now(self) -> int:
        """The time, noted."""
        self.clock_ns.append(self.clock())
        return self.clock_ns[-1]

    def change(self, change: Change) -> None:
        """An object that came, went, or is searched for anew."""
        action: Action = "remove" if change.removed else "reset" if change.added is None else "add"
        self.changes.append(ObjectChange(action=action, entry=change.entry))

    @property
    def empty(self) -> bool:
        """Whether nothing was taken."""
        return not (self.changes or self.corrections or self.frame or self.clock_ns)

    def mark(self, stage: str, tracker: Tracker) -> None:
        """Note what is believed after a stage."""
        if self.heard:
            self.marks.append(StageMark(stage=stage, checksum=checksum(tracker)))

    @contextmanager
    def stages(self, tracker: Tracker) -> Iterator[None]:
        """The same after each stage of the library that runs inside."""
        if not self.heard:
            yield
            return
        with listening(_Marking(self, tracker)):
            yield

    def message(self, seq: int) -> IntakeMessage:
        """What is told of it."""
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
