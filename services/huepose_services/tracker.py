"""The tracker worker: tracks the newest frame, publishes the poses at once, and applies corrections between
frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import msgspec

from huepose.believe.state import State
from huepose.geometry import RgbdFrame
from huepose.judge.relit import relit
from huepose.model import ReferenceModel
from huepose.profiles import profile
from huepose.support.errors import InputError
from huepose.tracking import Tracker, memory
from huepose.tracking.subject import Subject
from huepose.tracking.types import Applied, Correction, TrackedPose
from huepose_protos import WireError
from huepose_protos.messages import CorrectionMessage, FrameHeader, MemoryMessage
from huepose_services import models
from huepose_services.convert import frame_from_wire, frame_key, from_wire, tracked_to_wire
from huepose_services.delay_doubt import DelayDoubt
from huepose_services.doubts import (
    TOO_OLD,
    Against,
    complaint_about,
    lens_doubted,
    refused_text,
    why_all_are_lost,
    why_doubted,
    why_refused,
)
from huepose_services.first_frame import FirstFrame
from huepose_services.following import Follower, Retired
from huepose_services.held import held
from huepose_services.intake import MEMORY_EVERY_NS, Clock, InputCache, Intake
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, check_number, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.log import StateChanges
from huepose_services.runtime.work import Work

# While no new frame comes, SUSPECT poses are published again this often, for subscribers that come late.
_SAID_AGAIN_NS = SECOND
_Frame = tuple[int, int]
_Instance = tuple[str, int]


class _Own(msgspec.Struct, array_like=True):
    """The worker's own memory, beside that of the tracker."""

    newest: _Frame | None = None
    first: _Frame | None = None
    """The first frame of this camera epoch."""
    published: set[_Instance] = set()
    """The instances whose poses in the newest frame were published, without those that were LOST."""
    retired: Retired = msgspec.field(default_factory=Retired)
    holds_until_ns: int = 0
    """Until then the poses that were TRACKING in the newest frame stay valid without a newer frame. Then
    they are published as SUSPECT, again and again."""
    fx_of_size: dict[str, float] = {}
    complaint: str | None = None
    against: Against = msgspec.field(default_factory=Against)
    relit: set[_Instance] = set()
    """Instances that have not been TRACKING since a frame in which the colour of the light changed."""
    delay: DelayDoubt = msgspec.field(default_factory=DelayDoubt)


FrameOf = Callable[[int, int], tuple[FrameHeader, RgbdFrame] | None]


def make(bus: Bus, config: Config) -> TrackerWork:
    """The tracker worker's work, with its kernels compiled."""
    known = models.load(config)
    tracker = tracker_of(config, known)
    tracker.warm_up()
    follower = Follower(bus, lambda name: _load_one(config, name), known, remembers=True)
    return TrackerWork(bus, tracker, follower, config, cache=InputCache(bus))


def _load_one(config: Config, name: str) -> ReferenceModel:
    """The model of one object. What the tracker derives from it is computed here, so that no frame
    waits."""
    model = models.load_one(config, name)
    Subject.of(model).make_ready()  # keeps its lines in the model and its views in the cache
    return model


def tracker_of(config: Config, known: Mapping[str, ReferenceModel]) -> Tracker:
    """The library's tracker with the settings of the configuration."""
    static_camera = config.camera.mount is not None and not config.camera.told
    settings = replace(
        profile(config.profile).tracker,
        history_frames=config.tracker.history_frames,
        older_frames=config.tracker.older_frames,
        odometry=config.tracker.odometry and not static_camera,
    )
    return Tracker(known, settings)


class TrackerWork(Work):
    """Each step applies all corrections that arrived, then tracks the newest frame and publishes its
    poses."""

    def __init__(
        self,
        bus: Bus,
        tracker: Tracker,
        objects: Follower[ReferenceModel],
        config: Config,
        clock: Clock = now_ns,
        cache: InputCache | None = None,
    ) -> None:
        self._bus, self._tracker, self._objects, self._config = bus, tracker, objects, config
        self._clock, self._cache = clock, cache
        self._intake = Intake(clock)
        self._seq = self._memory_due_ns = 0
        self._max_age_ns = int(config.tracker.max_age_ms * 1e6)
        self._told = StateChanges(bus.log)
        self._refused: tuple[str, int, int] | None = None
        self._corrections = bus.inbox.queue(bus.keys.correction)
        self._frames, self._first_frame = bus.frames(), FirstFrame(bus.health, bus.log)
        self._header: FrameHeader | None = None
        self._pixels: RgbdFrame | None = None
        self._own = _Own()
        # The poses of the newest frame that were published as TRACKING.
        self._believed: list[TrackedPose] = []

    def reload(self, config: Config) -> list[str]:
        """Take over `tracker.max_age_ms`. A recorder gets the memory, which has the new configuration and
        the number of the step."""
        age_ms = config.tracker.max_age_ms
        fresh = msgspec.structs.replace(self._config.tracker, max_age_ms=age_ms)
        self._config = msgspec.structs.replace(self._config, tracker=fresh)
        self._max_age_ns = int(age_ms * 1e6)
        if self._bus.is_heard(self._bus.keys.intake):
            self._bus.put_aside(self._bus.keys.memory, self.memory())
        return []

    def due_ns(self) -> int | None:
        """When TRACKING poses become too old, or old poses are due to be published again, if no newer frame
        comes."""
        return self._own.holds_until_ns if self._believed else None

    def step(self) -> None:
        """Apply what arrived, then track the newest frame."""
        self._intake = Intake(self._clock, self._bus.is_heard(self._bus.keys.intake))
        try:
            self._take()
        finally:
            if not self._intake.empty:
                self._seq += 1
                self._publish_log()

    def _take(self) -> None:
        self._follow()
        corrected: set[_Instance] = set()
        while (message := self._bus.take(self._corrections, CorrectionMessage)) is not None:
            self._intake.corrections.append(message)
            if self._correct(message):
                corrected.add((message.object, message.instance))
        if not self._intake.empty:
            self._intake.mark("corrections", self._tracker)
        taken = self._bus.take_with_payload(self._frames, FrameHeader)
        self._first_frame.look(taken is not None)
        tracked = taken is not None and self._track(*taken)
        if corrected and not tracked and self._header is not None:
            # Instances that are new, or were LOST, are published on the last frame, because the next may come
            # late. A pose that was already published on that frame is not published again.
            new = [p for p in self._tracker.poses() if p.key in corrected - self._own.published]
            self._publish_all(new, self._header, self._pixels)
        if self._intake.empty and self._believed and (now := self._clock()) >= self._own.holds_until_ns:
            self._intake.clock_ns.append(now)
            ends = ": the recording has ended, or it falls behind" if self._config.camera.once else ""
            self._withdraw(f"no new frame came{ends}")
            self._own.holds_until_ns = now + _SAID_AGAIN_NS

    def _withdraw(self, why: str) -> None:
        """Publish the poses that were TRACKING again, as SUSPECT, without a newer frame."""
        header, before = self._header, self._believed
        self._believed = [_doubted(pose) for pose in before]
        if header is None:
            return
        fresh = sum(pose.state is State.TRACKING for pose in before)
        if fresh:
            self._bus.log.seldom("withdrawn", f"poses are SUSPECT: {why}")
            self._bus.health.count("poses_too_old", fresh)
        for pose in self._believed:
            self._put(pose, header, self._intake.now(), _sentence(why))

    def _publish_log(self) -> None:
        """Publish the log of the step for a recorder, and the memory every few seconds."""
        bus, keys = self._bus, self._bus.keys
        if not self._intake.recorded:
            self._memory_due_ns = 0
            return
        log = self._intake.message(self._seq)
        if self._cache is not None:
            self._cache.step(log)
        bus.put_aside(keys.intake, log)
        now = now_ns()
        if now >= self._memory_due_ns:
            self._memory_due_ns = now + MEMORY_EVERY_NS
            bus.put_aside(keys.memory, self.memory())

    def memory(self) -> MemoryMessage:
        """The whole memory of the tracker and of this worker."""
        own = msgspec.to_builtins(self._own, order="deterministic")
        tracking, plain = memory.plain(self._believed, self._tracker), memory.state_of(self._tracker)
        return MemoryMessage(
            publish_ns=now_ns(),
            seq=self._seq,
            config=msgspec.json.encode(self._config).decode(),
            objects=list(self._tracker.objects),
            memory=msgspec.msgpack.encode((plain, own, tracking)),
            frames=list(dict.fromkeys([*memory.frames_of(plain), *filter(None, [self._own.newest])])),
        )

    def take_over(self, message: MemoryMessage, frame_of: FrameOf) -> None:
        """Take over the memory of another worker with the same objects and configuration. frame_of: gives
        the header and the frame of a camera epoch and frame number. Raises InputError for a memory that
        does not fit."""

        def pixels(epoch: int, frame_id: int) -> RgbdFrame | None:
            found = frame_of(epoch, frame_id)
            return None if found is None else found[1]

        try:
            plain, own, tracking = msgspec.msgpack.decode(message.memory)
            self._own = msgspec.convert(own, _Own)
        except (msgspec.MsgspecError, ValueError, TypeError, RecursionError) as error:
            raise InputError("the tracker's memory", found=str(error)[:200], expected="MessagePack") from None
        memory.taken_over(self._tracker, plain, pixels)
        self._believed = memory.restored(tracking, self._tracker, pixels)
        found = None if self._own.newest is None else frame_of(*self._own.newest)
        self._header, self._pixels = (None, None) if found is None else found
        self._seq = message.seq

    def _follow(self) -> None:
        """Apply changes of the object list."""
        for change in self._objects.changes():
            self._intake.change(change)
            name = change.entry.object
            self._own.retired.add(name, change.entry.retired)
            self._believed = [pose for pose in self._believed if pose.object != name]
            self._bus.forget(self._bus.keys.of_tail(f"pose/{name}"))
            self._told.forget(name)
            if change.removed:
                self._tracker.remove_object(name)
            elif change.added is not None:
                self._tracker.add_object(change.added)
            else:
                self._tracker.remove_instances(name)
        self._told.flush()

    def _correct(self, message: CorrectionMessage) -> bool:
        """Apply a correction. Returns whether it was applied, or will be."""
        if self._own.retired.includes(message.object, message.camera_epoch, message.instance):
            self._bus.health.count("corrections_of_retired")
            return False
        if message.object not in self._tracker.objects:
            # One that was just added may be found before its model is loaded here, which takes seconds.
            self._bus.health.count("corrections_of_unknown")
            return False
        try:
            check_number(message, self._intake.now())
            applied = self._tracker.correct(from_wire(Correction, message))
        except (WireError, InputError) as error:
            wrong = error if isinstance(error, WireError) else WireError(str(error))
            self._bus.refuse(self._bus.keys.correction, wrong)
            return False
        if applied is not Applied.REFUSED_EPOCH:
            self._own.against.hear(message)
        self._bus.health.count(f"corrections_{applied.value}")
        if applied in (Applied.APPLIED, Applied.CATCHING_UP):
            self._bus.health.warn_while("late", None)
            return True
        if applied is not Applied.REPEATED:
            self._refuse(message, applied)
        return False

    def _refuse(self, message: CorrectionMessage, applied: Applied) -> None:
        """Log why a correction was not applied; health warns where perception is too slow."""
        key, header = (message.object, message.instance), self._header
        older = self._tracker.config.older_frames
        age_s = 0.0 if header is None else (header.capture_ns - message.capture_ns) * 1e-9
        followed = key in self._tracker.instances or message.verdict != "agree"
        why, fault = why_refused(applied, followed, age_s, self._tracker.reach_s, older)
        if fault and applied is Applied.REFUSED_OLD:
            self._bus.health.warn_while("late", why)
        # The re-initialisation loop repeats its corrections: the log says it once.
        if self._refused != (*key, message.seq):
            self._refused = (*key, message.seq)
            text = refused_text(f"{key[0]}/{key[1]}", message.verdict, age_s, why)
            self._bus.log.seldom("refused", text, level="warn" if fault else "info")

    def _track(self, header: FrameHeader, payload: bytes) -> bool:
        """Track a frame. Returns False for a repeated, older or malformed one."""
        started, health, before = now_ns(), self._bus.health, self._header
        if self._own.newest == frame_key(header):
            health.count("frames_repeated")
            return False
        try:
            frame = frame_from_wire(header, payload)
        except WireError as error:
            self._bus.refuse(self._bus.keys.frame, error)
            return False
        if before is None or before.camera_epoch != header.camera_epoch:
            self._own.first = frame_key(header)
            self._withdraw("the camera was opened again")
        if self._cache is not None:
            self._cache.frame(header, payload, frame, self._intake.recorded)
        complaint = complaint_about(frame, self._pixels) or lens_doubted(frame, self._own.fx_of_size)
        believed, pixels = {p.key for p in self._believed}, self._pixels
        health.warn_while("frame", complaint)
        self._intake.frame = header
        with self._intake.stages(self._tracker):
            poses = self._tracker.step(frame)
        if not poses and self._tracker.poses():
            # A newer frame was tracked already: the poses published for that one stay valid.
            health.count("frames_older")
            return False
        self._pixels, self._believed, self._own.complaint = frame, [], complaint
        self._own.published.clear()
        if self._config.camera.check:
            health.warn_while("delay", self._own.delay.look(frame, poses, self._tracker))
        doubted = {p.key for p in poses if p.state is not State.TRACKING}
        self._own.relit &= doubted
        if pixels is not None and (fallen := doubted & believed) and relit(pixels.color, frame.color):
            self._own.relit |= fallen
        if complaint is not None or header.camera:
            health.count("frames_doubted")
        self._publish_all(poses, header, frame)
        if self._bus.is_heard(self._bus.keys.hypotheses):
            self._bus.put_aside(self._bus.keys.hypotheses, held(self._tracker, header, now_ns()))
        self._header, self._own.newest = header, frame_key(header)
        health.counters["frames_skipped"] = self._frames.skipped
        health.count("frames")
        health.worked_on(started, header)
        return True

    def _publish_all(self, poses: list[TrackedPose], header: FrameHeader, frame: RgbdFrame | None) -> None:
        epoch = header.camera_epoch
        complaint = self._own.complaint or self._own.against.every_pose(epoch)
        against = [self._own.against.pose(pose, epoch) or self._own.delay.of(pose) for pose in poses]
        every = complaint or header.camera
        poses = [_doubted(pose) if every or one else pose for pose, one in zip(poses, against, strict=True)]
        surfaces = [self._tracker.surface(pose.object) for pose in poses]
        # A fault that the camera reports explains all that is wrong with the poses in its image.
        of_frame = header.camera or header.picture or _sentence(complaint)
        of_frame = of_frame or why_all_are_lost(frame, poses, surfaces)
        for pose, surface, one in zip(poses, surfaces, against, strict=True):
            doubted = pose.state is not State.TRACKING
            reason = (of_frame or one) if doubted else ""
            if doubted and not reason and frame is not None:
                doubt = self._tracker.doubt(*pose.key)
                reason = why_doubted(surface, frame, pose.T_cam_obj, doubt, pose.key in self._own.relit)
            self._publish(pose, header, reason)
            if pose.T_cam_obj is not None:
                self._own.published.add(pose.key)

    def _publish(self, pose: TrackedPose, header: FrameHeader, reason: str) -> None:
        now = self._intake.now()
        # A timestamp in the future says as little about now as an old one.
        old = abs(now - pose.stamp_ns) > self._max_age_ns
        # A recording that is played once repeats its first frame until objects are found: it never gets old.
        repeated = self._config.camera.once and frame_key(header) == self._own.first
        if pose.state is State.TRACKING and old and not repeated:
            # The object may have moved since, however sure the pose is.
            pose, reason = _doubted(pose), TOO_OLD
            self._bus.health.count("poses_too_old")
        self._put(pose, header, now, reason)
        if pose.state is State.TRACKING and not repeated:
            self._believed.append(pose)
            self._own.holds_until_ns = now + self._max_age_ns

    def _put(self, pose: TrackedPose, header: FrameHeader, now: int, reason: str) -> None:
        try:
            centre = self._tracker.surface(pose.object).arrays.centre
            message = tracked_to_wire(pose, header, now, centre, reason)
        except ValueError as error:
            # Not finite, or not a rotation: this pose is not published, those of other objects are.
            self._bus.health.count("poses_refused")
            self._bus.log.seldom("refused pose", f"pose of {pose.object}/{pose.instance}: {error}")
            return
        self._bus.put(self._bus.keys.pose(pose.object, pose.instance), message)
        how = f"quality {pose.quality:.2f}" + (f"; {reason}" if reason else "")
        self._told.note(f"{pose.object}/{pose.instance}", pose.state, how)
        self._bus.health.count(f"poses_{pose.state.lower()}")


def _doubted(pose: TrackedPose) -> TrackedPose:
    return replace(pose, state=State.SUSPECT) if pose.state is State.TRACKING else pose


def _sentence(text: str) -> str:
    return text and text[0].upper() + text[1:].rstrip(".") + ("" if text.endswith("?") else ".")
