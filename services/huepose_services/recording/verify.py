"""Computes the poses of a recording again, and compares them bit by bit.

The tracker worker itself runs here, step by step, with a bus and a clock that replay the inputs in the
recording. It starts from the first memory of the tracker whose frames are all in the recording. After a step
whose input is missing it starts again from the next such memory.
"""

from __future__ import annotations

import heapq
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import cv2
import msgspec

from huepose.geometry import RgbdFrame
from huepose.model import ReferenceModel
from huepose.support.errors import InputError
from huepose.support.progress import progress
from huepose.support.words import listed
from huepose_protos import WireError, encode
from huepose_protos.keys import Keys
from huepose_protos.messages import (
    CorrectionMessage,
    FrameHeader,
    IntakeMessage,
    MemoryMessage,
    Message,
    PoseMessage,
)
from huepose_services import models
from huepose_services.convert import frame_from_wire
from huepose_services.following import Change, Follower
from huepose_services.recording.arrivals import FrameKey, frame_taken
from huepose_services.recording.read import Event, Recording
from huepose_services.recording.record import about_this_machine
from huepose_services.recording.report import Report
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND
from huepose_services.runtime.config import Config
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.tracker import TrackerWork, tracker_of

_LAG_NS = 6 * SECOND
"""Messages of the tracker are processed so much later than the others, because their frames and poses may be
written after them; those that the recorder had to request come seconds later."""
_TAKEN = 256
"""Frames that are kept after the tracker took them: more than it remembers."""
_FRAMES = 1024
"""Frames that are kept in all: half a minute, in case the tracker is that far behind."""

_ITS_MODELS = "the folder of the models that it was recorded with: --bundles DIR"

_Pixels = tuple[FrameHeader, bytes]
_PoseKey = tuple[str, int, int]


def verify(recordings: list[Recording], bundles: Path | None = None) -> Report:
    """Verify recordings of one run, in their order. bundles: the folder of the reference models, if they
    moved.

    Raises InputError for a recording that cannot be verified: inexact images, other reference models."""
    cv2.setNumThreads(1)  # as in the worker
    verifier = _Verifier(recordings, bundles)
    for recording in recordings:
        for event in progress(recording.events(), f"{recording.path}: messages"):
            if isinstance(event.message, FrameHeader) and not recording.exact:
                raise InputError(
                    recording.path,
                    found="images as JPEG",
                    expected="exact ones",
                    fix="Record without --jpeg.",
                )
            verifier.take(event)
            if verifier.report.difference:
                return verifier.report
    verifier.finish()
    return verifier.report


class _Verifier:
    def __init__(self, recordings: list[Recording], bundles: Path | None) -> None:
        self.report = Report()
        self._recordings, self._bundles = recordings, bundles
        self._models: dict[str, ReferenceModel] = {}
        self._digests: dict[str, str] = {}
        self._frames: dict[FrameKey, _Pixels] = {}
        self._taken: dict[FrameKey, None] = {}
        self._poses: dict[_PoseKey, PoseMessage] = {}
        self._held: list[tuple[int, int, IntakeMessage | MemoryMessage]] = []
        self._order = self._last_seq = self._newest_ns = 0
        self._replay: _Replay | None = None
        self._first_ns: int | None = None

    def take(self, event: Event) -> None:
        """Process the next event of the recording."""
        message = event.message
        self._newest_ns = max(self._newest_ns, message.publish_ns)
        if isinstance(message, FrameHeader):
            self._frames[message.camera_epoch, message.frame_id] = (message, event.payload)
            while len(self._frames) > _FRAMES:
                del self._frames[next(iter(self._frames))]
        elif isinstance(message, PoseMessage):
            self._poses[message.object, message.instance, message.publish_ns] = message
        elif isinstance(message, IntakeMessage | MemoryMessage):
            self._order += 1
            heapq.heappush(self._held, (message.publish_ns, self._order, message))
        while self._held and self._held[0][0] < self._newest_ns - _LAG_NS and not self.report.difference:
            self._next()

    def finish(self) -> None:
        """Process the messages that were held back."""
        while self._held and not self.report.difference:
            self._next()
        for name in self._models:
            self._check_digest(name)

    def _next(self) -> None:
        _, _, message = heapq.heappop(self._held)
        self._first_ns = message.publish_ns if self._first_ns is None else self._first_ns
        if isinstance(message, MemoryMessage):
            self._remember(message)
        else:
            self._step(message)

    def _remember(self, message: MemoryMessage) -> None:
        replay = self._replay
        if replay is not None and replay.seq == message.seq:
            if replay.work.memory().memory != message.memory:
                self._differs(None, "memory", "the tracker's state, beside the poses")
                return
            self.report.memories += 1
            if replay.recorded_config == message.config:
                return
        if all(key in self._frames for key in message.frames):
            self._replay = _Replay(message, self._config(message), self._known, self._frames)

    def _config(self, message: MemoryMessage) -> Config:
        try:
            config = msgspec.json.decode(message.config, type=Config)
        except (msgspec.MsgspecError, RecursionError) as error:
            raise InputError("the recorded configuration", found=str(error)[:200]) from None
        bundles = config.bundles if self._bundles is None else str(self._bundles)
        return msgspec.structs.replace(config, bundles=bundles)

    def _known(self, config: Config, name: str) -> ReferenceModel:
        """A reference model. Raises InputError for another one than was used for the recording."""
        if name not in self._models:
            try:
                self._digests |= models.digests(config, [name])
            except InputError as error:
                raise InputError(
                    error.what,
                    found=error.found,
                    expected=f"the reference model {name}",
                    fix=f"Give {_ITS_MODELS}.",
                ) from None
            self._check_digest(name)
            self._models[name] = models.load_one(config, name)
        return self._models[name]

    def _check_digest(self, name: str) -> bool:
        """Whether a recording says yet which reference model was used. Raises InputError for another one."""
        expected = next((n for r in self._recordings if (n := r.notes.get("models", {}).get(name))), None)
        found = self._digests[name]
        if expected and found != expected:
            raise InputError(
                f"reference model {name}",
                found=f"one with SHA-256 {found[:12]}...",
                expected=f"the one that was used, {expected[:12]}...",
                fix=f"Give {_ITS_MODELS}.",
            )
        return expected is not None

    def _unnoted_models(self) -> list[str]:
        """The models for which no recording has noted a digest. All notes are read first: for an object
        that was added, the note comes later than the object. Raises InputError for another model than
        noted."""
        for recording in self._recordings:
            for _ in recording.chunks():
                pass
        return [name for name in self._models if not self._check_digest(name)]

    def _step(self, intake: IntakeMessage) -> None:
        replay = self._replay
        key = frame_taken(intake)
        pixels = None if key is None else self._frames.get(key)
        if replay is not None and (intake.seq != replay.seq + 1 or (key is not None and pixels is None)):
            what = f"step {replay.seq + 1} is missing" if pixels or not key else f"frame {key[1]} is missing"
            self.report.gaps.append(f"{self._at(intake)}: {what}, which the tracker took")
            replay = self._replay = None
        if replay is None:
            self.report.skipped += 1
            self.report.skipped_first += not self.report.steps
        else:
            self._compare(intake, *replay.step(intake, pixels))
        if intake.seq != self._last_seq + 1:
            self._taken |= dict.fromkeys(self._frames)  # the missing steps may have taken any of them
        self._last_seq = intake.seq
        if key is not None:
            self._taken[key] = None
            self._forget_before(key)

    def _forget_before(self, newest: FrameKey) -> None:
        """Drop the frames that the tracker skipped, and the oldest that it took."""
        if newest in self._frames:
            said_ns = self._frames[newest][0].publish_ns
            for key, (header, _) in list(self._frames.items()):
                if header.publish_ns < said_ns and key not in self._taken:
                    del self._frames[key]
        while len(self._taken) > _TAKEN:
            oldest = next(iter(self._taken))
            del self._taken[oldest]
            self._frames.pop(oldest, None)

    def _compare(self, was: IntakeMessage, now: IntakeMessage, poses: list[PoseMessage], error: str) -> None:
        at_s = self._seconds(was)
        self.report.from_s = self.report.from_s if self.report.steps else at_s
        self.report.until_s = at_s
        self.report.steps += 1
        self.report.without_pose += not poses
        for before, after in zip(was.marks, [*now.marks, *[None] * len(was.marks)], strict=False):
            if before != after:
                self._differs(was, before.stage, error or "the tracker's state after it")
                return
        if (was.clock_ns, len(was.marks)) != (now.clock_ns, len(now.marks)):
            self._differs(was, "publish", error or "how often it read the clock")
            return
        for pose in poses:
            recorded = self._poses.pop((pose.object, pose.instance, pose.publish_ns), None)
            if recorded is None:
                self.report.unrecorded += 1
                continue
            if encode(recorded) != encode(pose):
                self._differs(was, "publish", _fields(recorded, pose))
                return
            self.report.poses += 1
        left = [key for key in self._poses if key[2] in was.clock_ns]
        if left:
            self._differs(was, "publish", f"{left[0][0]}/{left[0][1]} has no pose now")

    def _differs(self, intake: IntakeMessage | None, stage: str, what: str) -> None:
        where = "a frame" if intake is None else self._at(intake)
        text = f"{where}, stage {stage}: {what}"
        if unnoted := self._unnoted_models():
            text += (
                f" (the recording does not say which reference models it used: where {listed(unnoted)} may "
                f"be another one than then, give {_ITS_MODELS})"
            )
        here, there = about_this_machine(), self._recordings[0].notes.get("huepose", {})
        other = [f"{k} {there[k]} there, {here[k]} here" for k in here if there.get(k, here[k]) != here[k]]
        self.report.difference = text + (f" (not the same: {'; '.join(other)})" if other else "")

    def _at(self, intake: IntakeMessage) -> str:
        key, at_s = frame_taken(intake), self._seconds(intake)
        where = f"step {intake.seq}" if key is None else f"frame {key[1]} of epoch {key[0]}"
        return f"{where} ({at_s:.2f} s after the beginning)"

    def _seconds(self, intake: IntakeMessage) -> float:
        return (intake.publish_ns - (self._first_ns or 0)) * 1e-9


def _fields(recorded: PoseMessage, again: PoseMessage) -> str:
    a, b = msgspec.structs.asdict(recorded), msgspec.structs.asdict(again)
    different = [f"{name} {a[name]} recorded, {b[name]} now" for name in a if a[name] != b[name]]
    return f"{again.object}/{again.instance}: {different[0][:200] if different else 'bytes'}"


class _Replay:
    """The tracker worker, run from a memory on. known: from a configuration and a name to a reference
    model."""

    def __init__(
        self, memory: MemoryMessage, config: Config, known: Any, frames: dict[FrameKey, _Pixels]
    ) -> None:
        self._config, self._known, self.recorded_config = config, known, memory.config
        self._bus = ReplayBus()
        objects = {name: known(config, name) for name in memory.objects}
        tracker = tracker_of(config, objects)
        self.work = TrackerWork(
            cast(Bus, self._bus), tracker, cast(Follower, self._bus), config, self._bus.read_clock
        )
        decoded: dict[FrameKey, tuple[FrameHeader, RgbdFrame]] = {}

        def frame_of(epoch: int, frame_id: int) -> tuple[FrameHeader, RgbdFrame] | None:
            # One object for each frame, however often it is asked for.
            key = (epoch, frame_id)
            if key not in decoded and key in frames:
                decoded[key] = (frames[key][0], frame_from_wire(*frames[key]))
            return decoded.get(key)

        self.work.take_over(memory, frame_of)
        self.seq = memory.seq

    def step(
        self, intake: IntakeMessage, pixels: _Pixels | None
    ) -> tuple[IntakeMessage, list[PoseMessage], str]:
        """Run one step with the recorded inputs. Returns its log, its poses, and the exception if one was
        raised."""
        bus, self.seq, error = self._bus, intake.seq, ""
        bus.give(intake, pixels, [self._change(one) for one in intake.changes])
        try:
            self.work.step()
        except Exception as raised:  # the live worker also goes on
            error = f"{type(raised).__name__}: {raised}"
        return bus.log_of_step or msgspec.structs.replace(intake, clock_ns=[], marks=[]), bus.poses, error

    def _change(self, change: Any) -> Change[ReferenceModel]:
        if change.action == "add":
            return Change(change.entry, added=self._known(self._config, change.entry.object))
        return Change(change.entry, removed=change.action == "remove")


class ReplayBus:
    """Stands in for the tracker worker's bus, inbox, object list and clock: it gives the recorded inputs of a
    step, and collects its outputs."""

    skipped = 0

    def __init__(self) -> None:
        self.keys, self.health = Keys("replay", "replay"), Health("tracker")
        self.log = Log("tracker", io.StringIO())
        self.inbox = self
        self.poses: list[PoseMessage] = []
        self.log_of_step: IntakeMessage | None = None
        self._corrections: list[CorrectionMessage] = []
        self._changes: list[Change[ReferenceModel]] = []
        self._pixels: _Pixels | None = None
        self._clock: Iterator[int] = iter(())
        self._last_ns = 0

    def give(
        self, intake: IntakeMessage, pixels: _Pixels | None, changes: list[Change[ReferenceModel]]
    ) -> None:
        """Set the inputs of the next step."""
        self.poses, self.log_of_step = [], None
        self._corrections, self._changes, self._pixels = list(intake.corrections), changes, pixels
        self._clock = iter(intake.clock_ns)

    def read_clock(self) -> int:
        """The next recorded clock reading; the last one again when there are no more."""
        self._last_ns = next(self._clock, self._last_ns)
        return self._last_ns

    def changes(self) -> list[Change[ReferenceModel]]:
        """The changes of the object list."""
        changes, self._changes = self._changes, []
        return changes

    def queue(self, key: str) -> str:
        """Stands for the inbox of corrections."""
        return key

    def frames(self) -> ReplayBus:
        """Stands for the inbox of frames."""
        return self

    def is_heard(self, key: str) -> bool:
        """The log of the worker's steps is; so no other message is made that is not compared."""
        return key == self.keys.intake

    def take(self, place: object, kind: type[Message]) -> Message | None:
        """The next correction of the step."""
        return self._corrections.pop(0) if self._corrections else None

    def take_with_payload(self, place: object, kind: type[Message]) -> _Pixels | None:
        """The frame of the step."""
        pixels, self._pixels = self._pixels, None
        return pixels

    def refuse(self, key: str, error: WireError) -> None:
        """Nothing to do: the same message was refused in the recorded run."""

    def put(self, key: str, message: PoseMessage) -> None:
        """Keep a pose for comparison."""
        self.poses.append(message)

    def forget(self, under: str) -> None:
        """Nothing to do: nothing is published."""

    def put_aside(self, key: str, message: Message) -> None:
        """Keep the log of the step for comparison."""
        if isinstance(message, IntakeMessage):
            self.log_of_step = message
