"""The re-initialisation worker: it gives the loop of `huepose.reinit`, a pure state machine, its clock and
its bus."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import asdict, replace
from typing import Literal

from huepose.believe.state import State
from huepose.estimation.types import PoseEstimate
from huepose.geometry.picture_faults import IF_IN_PLAIN_VIEW
from huepose.model import ReferenceModel
from huepose.reinit import ReinitConfig, ReinitLoop, warm_up
from huepose.reinit.newest_frame import Began, NewestFrame
from huepose.reinit.types import ObjectSlot, PerceptionResult, Request
from huepose.support.errors import InputError
from huepose.support.words import listed
from huepose.tracking.types import Correction, TrackedPose, Verdict
from huepose_protos import WireError
from huepose_protos.messages import (
    CameraMessage,
    ControlRequest,
    CorrectionMessage,
    Estimates,
    HealthMessage,
    ObjectEntry,
    ObjectsMessage,
    PerceptionRequest,
    PoseMessage,
)
from huepose_services import models
from huepose_services.convert import from_wire, requested_to_wire, to_wire
from huepose_services.following import Retired, recall
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, check_number, now_ns
from huepose_services.runtime.config import Config, ObjectConfig
from huepose_services.runtime.config_parts import PERCEPTION
from huepose_services.runtime.one_camera import OneCamera
from huepose_services.runtime.work import Work
from huepose_services.steering import MOST_OBJECTS, ObjectList, answer_control

_TICK_NS = SECOND // 30
# Health warns when perception answers later than this.
_SLOW_S = 1.5
# A track is over when it was not published for so long while others were, or while perception saw pictures:
# the tracker may have died, and a new one follows nothing.
_FORGET_NS = 2 * SECOND
# From the first answer about a camera: until then a right one has had objects found.
_IN_VAIN_NS = 10 * SECOND
# Which workers a request needs: with one that has begun, it is made anew.
_LISTENERS = (*PERCEPTION, "uplink")
# Bytes of an entry without its reason, and of the rest of a ControlReply, which has the list too: at most.
_ENTRY_BYTES, _REST_BYTES = 200, 8192
_UNCONFIRMED = "Something was found, but the tracker has not confirmed it."


def make(bus: Bus, config: Config) -> ReinitWork:
    """The re-initialisation worker's work."""

    def load(name: str, count: int) -> ObjectSlot:
        return _slot(name, count, models.load_one(config, name))

    entries = recall(bus)
    if entries:
        slots = [load(entry.object, entry.max_instances) for entry in entries]
        if told := unlike_file(entries, config.objects):
            bus.log.say(told)
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
    """Raises InputError for more objects than the list of them can have."""
    if len(objects) > MOST_OBJECTS:
        raise InputError(
            "objects",
            found=f"{len(objects)} that are looked for",
            expected=f"{MOST_OBJECTS} or fewer",
            fix="Name some of them in `objects`.",
        )


def unlike_file(entries: Sequence[ObjectEntry], configured: Sequence[ObjectConfig]) -> str:
    """How the list that another worker remembers differs from the file's, in one sentence: it may have been
    changed by command, or the file since. Empty where it does not, and where the file names no object."""
    known, named = {entry.object for entry in entries}, {item.name for item in configured}
    unlike = (("not in the file", known - named), ("only in the file", named - known))
    parts = [f"{what}: {listed(sorted(names))}" for what, names in unlike if names]
    if not named or not parts:
        return ""
    return f"objects are looked for as before the restart; {'; '.join(parts)} (huepose objects add, remove)"


def _settings(config: Config) -> ReinitConfig:
    return ReinitConfig(
        period_ms=1000.0 / config.reinit.rate_hz,
        objects_per_request=config.reinit.objects_per_tick,
        deadline_ms=float(config.reinit.deadline_ms),
    )


class ReinitWork(Work):
    """Gives the loop poses and answers; publishes its requests, its corrections, and the list of objects."""

    def __init__(
        self, bus: Bus, loop: ReinitLoop, objects: ObjectList, configured: Sequence[ObjectConfig] = ()
    ) -> None:
        # What of the file is looked for: a list from before may have other names than the file.
        counts = {entry.object: entry.max_instances for entry in objects.entries()}
        self._names_objects = bool(configured)
        self._of_file = {item.name: counts[item.name] for item in configured if item.name in counts}
        self._bus, self._loop, self._objects = bus, loop, objects
        answer_control(bus, objects)
        self._retired = Retired.of(objects.entries())
        self._poses = bus.inbox.queue(bus.keys.poses, wakes=False)
        self._answers = bus.inbox.queue(bus.keys.estimates)
        self._cameras = bus.inbox.ring(bus.keys.camera_info, wakes=False)
        self._camera_health = bus.inbox.ring(bus.keys.health("camera"), wakes=False)
        self._live = bus.inbox.liveliness(bus.keys.live())
        self._camera = OneCamera(again_counts=False)
        self._newest = NewestFrame()
        self._tracks: dict[tuple[str, int], TrackedPose] = {}
        self._sought: dict[int, tuple[str, ...]] = {}
        self._reasons: dict[str, str] = {}
        self._picture_blamed = False
        self._camera_says = ""
        self._answered_ns = 0
        self._newest_frame: tuple[int, int] | None = None
        self._camera_doubt = ""
        # Epochs of the camera: that of the answers and since when, and the last in which a pose was TRACKING.
        self._answers_of, self._answers_since_ns, self._sure_in = -1, 0, -1
        self._told_missing: dict[str, int] = {}
        self._next_tick_ns = self._next_objects_ns = now_ns()

    def reload(self, config: Config) -> list[str]:
        """Take over the section `reinit`, and the objects that were added to or removed from the file.
        Objects that were added by command stay."""
        self._loop.config = _settings(config)
        before, after = self._of_file, {item.name: item.max_instances for item in config.objects}
        if self._names_objects != bool(after):
            return ["a change that waits for the next start: objects (from all models to some, or back)"]
        now = {entry.object: entry.max_instances for entry in self._objects.entries()}
        orders = {name: _order("remove", name) for name in before if name not in after and name in now}
        orders |= {
            name: _order("add", name, count)
            for name, count in after.items()
            if count not in (before.get(name), now.get(name))
        }
        told = {name: self._objects.decide(order) for name, order in orders.items()}
        refused = {name: text for name, (done, text) in told.items() if not done}
        # What was refused is asked for again when the file is read again: its model may be there by then.
        self._of_file = {name: count for name, count in after.items() if name not in refused}
        self._of_file |= {name: before[name] for name in refused if name in before}
        return list(refused.values())

    def due_ns(self) -> int | None:
        """When to take poses, about once a frame; answers wake the loop."""
        return self._next_tick_ns

    def step(self) -> None:
        """Take what arrived; tick the loop when it is due."""
        started = now_ns()
        self._apply_orders()
        while (camera := self._bus.take(self._cameras, CameraMessage)) is not None:
            self._objects.picture_size = (camera.intrinsics.width, camera.intrinsics.height)
        while (health := self._bus.take(self._camera_health, HealthMessage)) is not None:
            if health.camera_epoch is not None and health.frame_id is not None:
                self._newest_frame = (health.camera_epoch, health.frame_id)
            if health.picture != self._camera_says:
                self._camera_says, self._next_objects_ns = health.picture, now_ns()
        while (worker := self._bus.take_begun(self._live)) is not None:
            if worker in _LISTENERS:
                self._loop.perception_begins()
        while (pose := self._bus.take(self._poses, PoseMessage)) is not None:
            self._observe(pose)
        while (answer := self._bus.take(self._answers, Estimates)) is not None:
            if not self._camera.agrees(answer.camera_epoch, now_ns()):
                self._bus.health.count("answers_of_another_camera")
                continue
            self._camera_doubt = answer.camera
            if self._counts(answer):
                self._answered_ns = min(answer.capture_ns, now_ns())
            corrections = self._loop.answer(now_ns(), result_from_wire(answer))
            for correction in corrections:
                self._send(correction)
            acquired = {c.object for c in corrections if c.verdict is Verdict.ACQUIRE}
            # In its picture or later: an older pose is of a tracker that has died since.
            tracks = (t for t in self._tracks.values() if t.stamp_ns >= answer.capture_ns)
            followed = {t.object for t in tracks if t.T_cam_obj is not None}
            sought = self._sought.get(answer.request_seq)
            if sought is not None:
                found = (e.object for e in answer.estimates if e.instance is None)
                sought = tuple(dict.fromkeys((*sought, *found)))
            advice = IF_IN_PLAIN_VIEW if self._in_vain(answer) else ""
            self._reasons |= reasons_not_seen(sought or (), answer, acquired, followed, advice)
            if bool(answer.picture) != self._picture_blamed:
                self._picture_blamed = bool(answer.picture)
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
            self._bus.put_control(self._bus.keys.request, request_to_wire(request))
        for correction in self._loop.repeats(now):
            self._send(correction)
        if now >= self._next_objects_ns or self._missing() != self._told_missing:
            self._next_objects_ns = now + SECOND
            self._publish_objects()

    def _in_vain(self, answer: Estimates) -> bool:
        """Whether pictures of its camera have been looked at for a while, and no pose in them was sure."""
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
        """Whether it is about the camera's epoch and clock that count now. Where one of them begins with it,
        what was followed is over."""
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
                # An answer to what was asked before says nothing about the new search.
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
            # What was said while it was followed says nothing about the search that begins now.
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
        missing, before = self._missing(), self._told_missing
        self._told_missing = missing
        entries = self._objects.entries()
        for entry in entries:
            name = entry.object
            count = missing.get(name, 0)
            if count < before.get(name, 0) and self._reasons.get(name) == _UNCONFIRMED:
                del self._reasons[name]  # it is confirmed, and another one is looked for
            # The camera knows best why its pictures show nothing.
            reason = self._camera_says or (self._reasons.get(name, "") if count else "")
            self._objects.tell(name, count, self._retired.below.get(name), shortened(reason, len(entries)))
        # What is ordered in this moment is published with the next step, which does it.
        if (settled := self._objects.settled()) is not None:
            self._bus.put(self._bus.keys.objects, ObjectsMessage(publish_ns=now_ns(), objects=settled))


def _order(action: Literal["add", "remove"], name: str, count: int = 1) -> ControlRequest:
    return ControlRequest(publish_ns=now_ns(), action=action, object=name, max_instances=count)


def shortened(reason: str, objects: int) -> str:
    """A reason that so many entries may have, and their list is no larger than its message may be.

    >>> len(shortened("x" * 2000, 64)), shortened("Too dark.", 64)
    (696, 'Too dark.')
    """
    room = (ObjectsMessage.max_bytes - _REST_BYTES) // max(objects, 1) - _ENTRY_BYTES
    data = reason.encode()
    return reason if len(data) <= room else f"{data[: room - 3].decode(errors='ignore')}..."


def slow_text(age_s: float, took_s: float) -> str | None:
    """The warning for perception that answers so late, and took so long for it; None where it is in time, or
    the picture was old already when it was asked."""
    if min(age_s, took_s) < _SLOW_S:
        return None
    return (
        f"perception answers {age_s:.1f} s after a picture was taken: what is lost is found again that much "
        "later. `huepose top` shows which worker takes how long; fewer other programs, fewer objects, or one "
        "at a time (reinit.objects_per_tick: 1) make it faster"
    )


def reasons_not_seen(
    sought: Iterable[str],
    answer: Estimates,
    acquired: Container[str] = (),
    followed: Container[str] = (),
    advice: str = "",
) -> dict[str, str]:
    """By name, why no new instance of an object was found in the answer's picture. sought: the objects of
    which a new instance was requested; acquired: those of which one was found and given to the tracker;
    followed: those of which one was followed before; advice: where none of any object was ever sure."""
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
            out[name] = "No second one is seen."
        elif best is None:
            out[name] = f"No place in the picture looks like the object. {advice}".strip()
        elif best.found:
            doubtful = f"too doubtful to follow (quality {best.quality:.2f})"
            out[name] = f"Something like it is seen, {doubtful}. {advice}".strip()
        else:
            out[name] = best.reason
    return out


def result_from_wire(message: Estimates) -> PerceptionResult:
    """Perception's answer of a message."""
    estimates = tuple(
        from_wire(PoseEstimate, e, instance=-1 if e.instance is None else e.instance, alternatives=())
        for e in message.estimates
    )
    return from_wire(PerceptionResult, message, request=message.request_seq, estimates=estimates)


def request_to_wire(request: Request) -> PerceptionRequest:
    """The message of a request."""
    objects, waiting = (
        [requested_to_wire(one) for one in some] for some in (request.objects, request.waiting)
    )
    return to_wire(
        PerceptionRequest,
        request,
        publish_ns=now_ns(),
        seq=request.number,
        objects=objects,
        waiting=waiting,
    )
