"""The re-initialisation worker: connects the loop of `huepose.reinit`, a pure state machine, to the clock
and the bus."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import asdict, replace

from huepose.believe.state import State
from huepose.estimation.types import PoseEstimate
from huepose.geometry.image_faults import IF_IN_PLAIN_VIEW
from huepose.model import ReferenceModel
from huepose.reinit import ReinitConfig, ReinitLoop, warm_up
from huepose.reinit.newest_frame import Began, NewestFrame
from huepose.reinit.types import ObjectSlot, PerceptionResult
from huepose.support.errors import InputError
from huepose.tracking.types import Correction, TrackedPose, Verdict
from huepose_protos import WireError
from huepose_protos.messages import (
    MOST_OBJECTS,
    CameraMessage,
    CorrectionMessage,
    Estimates,
    HealthMessage,
    ObjectEntry,
    ObjectsMessage,
    PoseMessage,
)
from huepose_services import models
from huepose_services.convert import from_wire, request_to_wire, to_wire
from huepose_services.following import Retired, reading_text, recall
from huepose_services.objects_of_file import ObjectsOfFile, unlike_file
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, check_number, now_ns
from huepose_services.runtime.config import PERCEPTION, Config, ObjectConfig
from huepose_services.runtime.one_camera import OneCamera
from huepose_services.runtime.work import Work
from huepose_services.steering import ObjectList, answer_control

_TICK_NS = SECOND // 30
# Health warns when perception answers later than this.
_SLOW_S = 1.5
# A track has ended when its pose is this much older than the newest pose or answer of perception: the
# tracker may have died, and a new one tracks nothing.
_FORGET_NS = 2 * SECOND
# In this time after the first answer in a camera epoch, a camera without faults has a pose that is
# TRACKING.
_IN_VAIN_NS = 10 * SECOND
# The workers that a request passes through: when one of them starts, the request is sent again.
_LISTENERS = (*PERCEPTION, "uplink")
# Upper bounds: bytes of an entry without its reason, and of the rest of a ControlReply, which also has the
# list.
_ENTRY_BYTES, _REST_BYTES = 200, 8192
_READING = "The detector is still reading its reference model."
_UNCONFIRMED = "Something was found, but the tracker has not confirmed it."


def make(bus: Bus, config: Config) -> ReinitWork:
    """The re-initialisation worker's work."""

    def load(name: str, count: int) -> ObjectSlot:
        return _slot(name, count, models.load_one(config, name))

    entries = recall(bus)
    if entries:
        slots = [load(entry.object, entry.max_instances) for entry in entries]
        if difference := unlike_file(entries, config.objects):
            bus.log.say(difference)
    else:
        require_carried(config.objects)
        known = models.load(config)
        items = config.objects or [ObjectConfig(name=name) for name in known]
        require_carried(items)
        entries = [
            ObjectEntry(object=item.name, max_instances=item.max_instances, searching=item.max_instances)
            for item in items
        ]
        slots = [_slot(e.object, e.max_instances, known[e.object]) for e in entries]
    warm_up()
    loop = ReinitLoop(_settings(config), slots)
    for entry in entries:
        if entry.retired is not None:
            loop.begin_at(entry.object, entry.retired[1])
    return ReinitWork(bus, loop, ObjectList(entries, load), config.objects)


def _slot(name: str, count: int, model: ReferenceModel) -> ObjectSlot:
    return replace(ObjectSlot.of(model, count), object=name)  # the file may have been renamed


def require_carried(objects: Sequence[ObjectConfig]) -> None:
    """Raises InputError for more objects than the list can have."""
    if len(objects) > MOST_OBJECTS:
        raise InputError(
            "objects",
            found=f"{len(objects)} that are searched for",
            expected=f"{MOST_OBJECTS} or fewer",
            fix="Name some of them in `objects`.",
        )


def _settings(config: Config) -> ReinitConfig:
    return ReinitConfig(
        period_ms=1000.0 / config.reinit.rate_hz,
        objects_per_request=config.reinit.objects_per_tick,
        deadline_ms=float(config.reinit.deadline_ms),
    )


class ReinitWork(Work):
    """Gives poses and answers to the loop; publishes its requests, its corrections, and the list of
    objects."""

    def __init__(
        self, bus: Bus, loop: ReinitLoop, objects: ObjectList, configured: Sequence[ObjectConfig] = ()
    ) -> None:
        self._bus, self._loop, self._objects = bus, loop, objects
        self._file = ObjectsOfFile(bus, objects, configured)
        answer_control(bus, objects)
        self._retired = Retired.of(objects.entries())
        self._poses = bus.inbox.queue(bus.keys.poses, wakes=False)
        self._answers = bus.inbox.queue(bus.keys.estimates)
        self._cameras = bus.inbox.ring(bus.keys.camera_info, wakes=False)
        self._health = bus.inbox.queue(bus.keys.health(), wakes=False)
        self._live = bus.inbox.liveliness(bus.keys.live())
        self._camera = OneCamera(again_counts=False)
        self._newest = NewestFrame()
        self._tracks: dict[tuple[str, int], TrackedPose] = {}
        # Added to the numbers of requests in messages, so that these are above all of an earlier loop: it
        # made less than one request in a millisecond.
        self._first_seq = now_ns() // 1_000_000
        # The objects of which the request of this number asks for a new instance.
        self._sought: dict[int, tuple[str, ...]] = {}
        self._reasons: dict[str, str] = {}
        self._image_has_fault = False
        self._camera_fault = ""
        self._detector_warns: list[str] = []
        self._answered_ns = 0
        self._newest_frame: tuple[int, int] | None = None
        self._camera_doubt = ""
        # Camera epochs: that of the answers and since when, and the last one in which a pose was TRACKING.
        self._answers_of, self._answers_since_ns, self._sure_in = -1, 0, -1
        self._published_missing: dict[str, int] = {}
        self._next_tick_ns = self._next_objects_ns = now_ns()

    def reload(self, config: Config) -> list[str]:
        """Take over the section `reinit`, and follow the objects of the file."""
        self._loop.config = _settings(config)
        return self._file.reload(config.objects)

    def due_ns(self) -> int | None:
        """When to take poses, 30 times a second; answers wake the worker."""
        return self._next_tick_ns

    def step(self) -> None:
        """Take what arrived; tick the loop when it is due."""
        started = now_ns()
        self._file.step()
        self._apply_orders()
        while (camera := self._bus.take(self._cameras, CameraMessage)) is not None:
            self._objects.picture_size = (camera.intrinsics.width, camera.intrinsics.height)
        while (health := self._bus.take(self._health, HealthMessage)) is not None:
            if health.worker == "detector":
                self._detector_warns = health.warnings
            if health.worker != "camera":
                continue
            if health.camera_epoch is not None and health.frame_id is not None:
                self._newest_frame = (health.camera_epoch, health.frame_id)
            if health.picture != self._camera_fault:
                self._camera_fault, self._next_objects_ns = health.picture, now_ns()
        while (worker := self._bus.take_begun(self._live)) is not None:
            if worker in _LISTENERS:
                self._loop.perception_begins()
        while (pose := self._bus.take(self._poses, PoseMessage)) is not None:
            self._observe(pose)
        while (answer := self._bus.take(self._answers, Estimates)) is not None:
            if not self._camera.agrees(answer.camera_epoch, now_ns()):
                self._bus.health.count("answers_of_another_camera")
                continue
            number = answer.request_seq - self._first_seq
            if not 0 < number <= self._loop.counters.requests:
                # A request of a loop that has died: its tracks may not be known here yet.
                self._bus.health.count("answers_to_an_earlier_loop")
                continue
            self._camera_doubt = answer.camera
            if self._counts(answer):
                self._answered_ns = min(answer.capture_ns, now_ns())
            corrections = self._loop.answer(now_ns(), result_from_wire(answer, number))
            for correction in corrections:
                self._send(correction)
            acquired = {c.object for c in corrections if c.verdict is Verdict.ACQUIRE}
            # In its frame or a later one: an older pose is of a tracker that has died since.
            tracks = (t for t in self._tracks.values() if t.stamp_ns >= answer.capture_ns)
            followed = {t.object for t in tracks if t.T_cam_obj is not None}
            sought = self._sought.get(number)
            if sought is not None:
                found = (e.object for e in answer.estimates if e.instance is None)
                sought = tuple(dict.fromkeys((*sought, *found)))
            advice = IF_IN_PLAIN_VIEW if self._in_vain(answer) else ""
            self._reasons |= reasons_not_seen(sought or (), answer, acquired, followed, advice)
            if bool(answer.picture) != self._image_has_fault:
                self._image_has_fault = bool(answer.picture)
                self._next_objects_ns = now_ns()
            self._bus.health.worked_on(started, answer)
            self._bus.health.warn_while("slow", slow_text(self._loop.answer_age_s, self._loop.answer_took_s))
        now = now_ns()
        if now < self._next_tick_ns:
            return
        self._next_tick_ns = max(self._next_tick_ns + _TICK_NS, now)
        request = self._loop.tick(now, self._living(), self._newest_frame)
        if request is not None:
            new = tuple(item.object for item in request.objects if item.instance is None)
            self._sought = {request.number: new}  # one request is in flight
            message = request_to_wire(request, self._first_seq + request.number)
            self._bus.put_control(self._bus.keys.request, message)
        for correction in self._loop.repeats(now):
            self._send(correction)
        if now >= self._next_objects_ns or self._missing() != self._published_missing:
            self._next_objects_ns = now + SECOND
            self._publish_objects()

    def _in_vain(self, answer: Estimates) -> bool:
        """Whether perception has answered in the camera epoch of the answer for a while, and no pose in it
        was TRACKING."""
        if answer.camera_epoch != self._answers_of:
            self._answers_of, self._answers_since_ns = answer.camera_epoch, now_ns()
        in_vain = now_ns() - self._answers_since_ns > _IN_VAIN_NS
        return in_vain and self._sure_in != answer.camera_epoch

    def _observe(self, pose: PoseMessage) -> None:
        try:
            check_number(pose, now_ns())
        except WireError as error:
            self._bus.refuse(self._bus.keys.poses, error)
            return
        if not self._camera.accepts(pose.camera_epoch, pose.capture_ns, now_ns()):
            self._bus.health.count("poses_of_another_camera")
        elif self._counts(pose) and not self._retired.includes(pose.object, pose.camera_epoch, pose.instance):
            self._tracks[pose.object, pose.instance] = track = from_wire(TrackedPose, pose)
            self._sure_in = pose.camera_epoch if track.state is State.TRACKING else self._sure_in

    def _counts(self, message: PoseMessage | Estimates) -> bool:
        """Whether a message is about the present camera epoch, and not from before its clock was set back.
        If the message begins a new epoch, or shows a clock set back, all tracks end."""
        frame = (message.camera_epoch, message.frame_id, message.capture_ns)
        if self._newest.note(*frame) is not Began.NOTHING:
            self._answered_ns = 0
            for name, _ in self._tracks:
                self._reasons.pop(name, None)
            self._tracks.clear()
        return self._newest.is_of(*frame)

    def _apply_orders(self) -> None:
        """Tell the loop about objects that were added, removed or reset."""
        orders = self._objects.orders()
        for order in orders:
            name = order.name
            if order.entry is None or order.anew:
                now = now_ns()
                over = self._loop.forget(name, now) if order.anew else self._loop.remove(name, now)
                self._retired.add(name, over)
                self._tracks = {key: track for key, track in self._tracks.items() if key[0] != name}
                # An answer to an earlier request says nothing about the new search.
                self._reasons.pop(name, None)
                self._sought = {n: tuple(o for o in asked if o != name) for n, asked in self._sought.items()}
            if order.slot is not None:
                self._loop.add(order.slot)
        if orders:
            self._publish_objects()

    def _living(self) -> list[TrackedPose]:
        newest_ns = max([self._answered_ns, *(t.stamp_ns for t in self._tracks.values())])
        over = [key for key, t in self._tracks.items() if newest_ns - t.stamp_ns >= _FORGET_NS]
        for key in over:
            del self._tracks[key]
            # A reason from the time when it was tracked says nothing about the search that begins now.
            self._reasons.pop(key[0], None)
        return list(self._tracks.values())

    def _send(self, correction: Correction) -> None:
        message = to_wire(CorrectionMessage, correction, publish_ns=now_ns(), camera=self._camera_doubt)
        self._bus.put_control(self._bus.keys.correction, message)

    def _missing(self) -> dict[str, int]:
        """How many instances of each object are searched for."""
        return {item.object: item.missing for item in self._loop.searching()}

    def _publish_objects(self) -> None:
        self._bus.health.counters |= asdict(self._loop.counters)
        missing, before = self._missing(), self._published_missing
        self._published_missing = missing
        entries = self._objects.entries()
        for entry in entries:
            name = entry.object
            count = missing.get(name, 0)
            if count < before.get(name, 0) and self._reasons.get(name) == _UNCONFIRMED:
                del self._reasons[name]  # it is confirmed, and another one is searched for
            # A fault that the camera itself reports is the better reason.
            said = _READING if reading_text(name) in self._detector_warns else self._reasons.get(name, "")
            reason = self._camera_fault or (said if count else "")
            self._objects.tell(name, count, self._retired.below.get(name), shortened(reason, len(entries)))
        # A change that was accepted in this moment is published by the next step, which applies it.
        if (settled := self._objects.settled()) is not None:
            self._bus.put(self._bus.keys.objects, ObjectsMessage(publish_ns=now_ns(), objects=settled))


def shortened(reason: str, objects: int) -> str:
    """The reason, cut so that a list of `objects` entries with such reasons fits in its message.

    >>> len(shortened("x" * 2000, 64)), shortened("Too dark.", 64)
    (696, 'Too dark.')
    """
    room = (ObjectsMessage.max_bytes - _REST_BYTES) // max(objects, 1) - _ENTRY_BYTES
    data = reason.encode()
    return reason if len(data) <= room else f"{data[: room - 3].decode(errors='ignore')}..."


def slow_text(age_s: float, took_s: float) -> str | None:
    """The warning that perception is slow. age_s: age of the image at the answer; took_s: time since the
    request. None if perception is in time, or the image was already old at the request."""
    if min(age_s, took_s) < _SLOW_S:
        return None
    return (
        f"perception answers {age_s:.1f} s after an image was taken: lost objects are found again that much "
        "later. `huepose top` shows the time of each worker. End other programs, search for fewer objects, "
        "or for one at a time (reinit.objects_per_tick: 1)"
    )


def reasons_not_seen(
    sought: Iterable[str],
    answer: Estimates,
    acquired: Container[str] = (),
    followed: Container[str] = (),
    advice: str = "",
) -> dict[str, str]:
    """By name, why no new instance of an object was found in the image of an answer. sought: the objects of
    which a new instance was requested; acquired: those of which one was found and given to the tracker;
    followed: those of which an instance is tracked already; advice: what to check, if no pose of any object
    was ever TRACKING."""
    out = {}
    for name in sought:
        if name in acquired:
            out[name] = _UNCONFIRMED
            continue
        mine = [e for e in answer.estimates if e.object == name and e.instance is None]
        best = max(mine, key=lambda e: e.quality, default=None)
        if answer.picture:
            out[name] = answer.picture
        elif name in followed:
            out[name] = "No second instance is visible."
        elif best is None:
            out[name] = f"No place in the image looks like the object. {advice}".strip()
        elif best.found:
            doubtful = f"too doubtful to track (quality {best.quality:.2f})"
            out[name] = f"Something like it is visible, {doubtful}. {advice}".strip()
        else:
            out[name] = best.reason
    return out


def result_from_wire(message: Estimates, number: int) -> PerceptionResult:
    """Perception's answer to the request of this number, from its message."""
    estimates = tuple(
        from_wire(PoseEstimate, e, instance=-1 if e.instance is None else e.instance, alternatives=())
        for e in message.estimates
    )
    return from_wire(PerceptionResult, message, request=number, estimates=estimates)
