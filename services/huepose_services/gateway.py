"""The gateway worker: publishes poses, objects, the camera and health to other machines, and accepts
nothing from them.

What is published inside under `huepose/SITE/CAMERA/KEY` appears outside under `.../remote/KEY`, with a
limited rate; a change of an object's state is never delayed. A subscriber that comes late sends a query (a
zenoh `get`) and gets the latest value of each key: a TRACKING pose that was not published again for a while
as SUSPECT, and no pose of an object that is no longer searched for. Inside and outside are two sessions;
only checked messages pass.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import zenoh

from huepose_protos import encode
from huepose_protos.messages import (
    CameraMessage,
    HealthMessage,
    Message,
    ObjectEntry,
    ObjectsMessage,
    PoseMessage,
)
from huepose_services.following import is_over
from huepose_services.gateway_door import Door
from huepose_services.gateway_session import open_outside
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.work import Work


@dataclass
class _Key:
    next_ns: int
    held: bytes | None = None


class Holdback:
    """Limits how often a key is sent; the caller passes the time. A value that comes too soon is held back,
    and only the newest one is sent later.

    >>> limit = Holdback(10.0)
    >>> limit.offer("pose", b"1", 0), limit.offer("pose", b"2", 1), limit.offer("pose", b"3", 2)
    (b'1', None, None)
    >>> limit.due(SECOND // 10), limit.held
    ([('pose', b'3')], 1)
    """

    def __init__(self, rate_hz: float) -> None:
        self.at_rate(rate_hz)
        self._keys: dict[str, _Key] = {}
        self.held = 0
        """How many values were replaced by newer ones and never sent."""

    def at_rate(self, rate_hz: float) -> None:
        """Change the rate."""
        self._period_ns = int(SECOND / rate_hz)

    def offer(self, key: str, value: bytes, now_ns: int, urgent: bool = False) -> bytes | None:
        """The value if it may be sent now, else None: then it is held back. An urgent one never is."""
        place = self._keys.setdefault(key, _Key(now_ns))
        self.held += place.held is not None
        if urgent or now_ns >= place.next_ns:
            # Deadlines are absolute, so that a source a little faster than the limit is thinned evenly.
            late_ns = now_ns - place.next_ns
            place.next_ns = (place.next_ns if 0 <= late_ns < self._period_ns else now_ns) + self._period_ns
            place.held = None
            return value
        place.held = value
        return None

    def due(self, now_ns: int) -> list[tuple[str, bytes]]:
        """The values that were held back and may be sent now."""
        out = []
        for key, place in self._keys.items():
            if place.held is not None and now_ns >= place.next_ns:
                out.append((key, place.held))
                place.held = None
                place.next_ns += self._period_ns
        return out

    def next_ns(self) -> int | None:
        """When the first value that is held back may be sent; None if there is none."""
        return min((place.next_ns for place in self._keys.values() if place.held is not None), default=None)

    def forget(self, key: str) -> None:
        """Remove a key that no longer exists."""
        self._keys.pop(key, None)


# A pose that was not published again for this long belongs to a track that has ended.
_FORGET_NS = 10 * SECOND
_SILENT = "Nothing was published about it for a while: the tracker has ended, or hangs."


def make(bus: Bus, config: Config) -> GatewayWork:
    """The gateway's work, its port open."""
    outside, door, warning = open_outside(config.gateway, bus.log.seldom)
    bus.health.warn_while("open", warning)
    if warning is not None:
        bus.log.warn(warning)
    return GatewayWork(bus, outside, door, config)


@dataclass(frozen=True)
class _Said:
    """The latest value of a key outside."""

    payload: bytes
    pose: PoseMessage | None
    at_ns: int

    @property
    def state(self) -> str | None:
        """The state of a pose; None for other messages."""
        return None if self.pose is None else self.pose.state


def answer_of(said: _Said, now_ns: int, max_age_ns: int) -> bytes:
    """The value as it is valid now: a TRACKING pose older than max_age_ns becomes SUSPECT, because a
    running tracker would have published a newer one."""
    if said.pose is None or said.state != "TRACKING" or now_ns - said.at_ns <= max_age_ns:
        return said.payload
    return encode(msgspec.structs.replace(said.pose, state="SUSPECT", publish_ns=now_ns, reason=_SILENT))


class GatewayWork(Work):
    """Passes on the messages that arrive, and answers queries."""

    def __init__(self, bus: Bus, outside: zenoh.Session, door: Door, config: Config) -> None:
        self._bus, self._outside, self._door = bus, outside, door
        keys, inbox = bus.keys, bus.inbox
        self._poses = inbox.queue(keys.poses)
        self._objects = inbox.queue(keys.objects, wakes=False)
        self._looked_for: list[ObjectEntry] | None = None
        self._camera = inbox.queue(keys.camera_info, wakes=False)
        self._health = inbox.queue(keys.health(), wakes=False)
        self._limit = Holdback(config.gateway.max_rate_hz)
        self._max_age_ns = int(config.tracker.max_age_ms * 1e6)
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._latest: dict[str, _Said] = {}
        self._lock = threading.Lock()
        self._asked = 0
        self._next_count_ns = now_ns()
        # A zenoh thread answers, so without delay; it is undeclared when the session closes.
        self._queryable = outside.declare_queryable(keys.remote, self._answer)

    def reload(self, config: Config) -> list[str]:
        """Take over the rate limit, the age limit of poses, and the door's limits and readers."""
        self._limit.at_rate(config.gateway.max_rate_hz)
        self._max_age_ns = int(config.tracker.max_age_ms * 1e6)
        self._door.reload(config.gateway)
        return []

    def due_ns(self) -> int | None:
        """When a value that was held back may be sent, or the counters are due."""
        held_ns = self._limit.next_ns()
        return self._next_count_ns if held_ns is None else min(held_ns, self._next_count_ns)

    def step(self) -> None:
        """Pass on what arrived and what is due."""
        keys = self._bus.keys
        while (objects := self._bus.take(self._objects, ObjectsMessage)) is not None:
            self._looked_for = objects.objects
            self._forget(lambda pose, _: is_over(pose, self._looked_for))
            self._tell(keys.objects, objects)
        while (pose := self._bus.take(self._poses, PoseMessage)) is not None:
            started = now_ns()
            if not is_over(pose, self._looked_for):
                self._tell(keys.pose(pose.object, pose.instance), pose)
            self._bus.health.worked_on(started, pose)
        while (camera := self._bus.take(self._camera, CameraMessage)) is not None:
            self._tell(keys.camera_info, camera)
        while (health := self._bus.take(self._health, HealthMessage)) is not None:
            self._tell(keys.health(health.worker), health)
        now = now_ns()
        for key, payload in self._limit.due(now):
            self._put(key, payload)
        if now >= self._next_count_ns:
            self._next_count_ns = now + SECOND
            self._forget(lambda _, at_ns: now - at_ns > _FORGET_NS)
            self._count()

    def _tell(self, inside: str, message: Message) -> None:
        key, payload, now = self._bus.keys.outside(inside), encode(message), now_ns()
        said = _Said(payload, message if isinstance(message, PoseMessage) else None, now)
        with self._lock:
            before = self._latest.get(key)
            self._latest[key] = said
        new = before is None or before.state != said.state
        if self._limit.offer(key, payload, now, urgent=new) is not None:
            self._put(key, payload)

    def _put(self, key: str, payload: bytes) -> None:
        if key not in self._publishers:
            # A reader that does not read loses messages; nobody waits for it.
            self._publishers[key] = self._outside.declare_publisher(
                key,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
        self._publishers[key].put(payload)
        self._bus.health.count("sent")

    def _forget(self, over: Callable[[PoseMessage, int], bool]) -> None:
        """Remove the poses for which over(pose, time of its publication) is true."""
        with self._lock:
            old = [k for k, said in self._latest.items() if said.pose and over(said.pose, said.at_ns)]
            for key in old:
                del self._latest[key]
        for key in old:
            self._limit.forget(key)
            if key in self._publishers:
                self._publishers.pop(key).undeclare()

    def _count(self) -> None:
        counters = self._bus.health.counters
        counters["held_back"] = self._limit.held
        counters["asked"] = self._asked
        counters["refused_readers"] = self._door.refused
        counters["readers_now"] = len(self._outside.info.peers_zid())

    def close(self) -> None:
        """Close all connections of readers."""
        self._door.close()
        self._outside.close()

    def _answer(self, query: zenoh.Query) -> None:
        """Reply with the latest value of each key of the query."""
        with self._lock:
            self._asked += 1
            said = [
                (key, value)
                for key, value in self._latest.items()
                if query.key_expr.intersects(zenoh.KeyExpr(key))
            ]
        for key, value in said:
            query.reply(key, answer_of(value, now_ns(), self._max_age_ns))
