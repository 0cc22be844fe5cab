"""The uplink worker, on the camera's computer: sends the input of perception up, and takes its answers.

A request goes up with the newest frame, so frames are sent at perception's own rate. An answer is accepted
only for a frame that was sent, with the same timestamp; the other computer's clock is never used.
"""

from __future__ import annotations

import zenoh
from msgspec.structs import replace

from huepose_protos import encode
from huepose_protos.messages import (
    Detections,
    Estimates,
    FrameHeader,
    HealthMessage,
    Look,
    Masks,
    ObjectsMessage,
)
from huepose_services.gateway_door import Door
from huepose_services.link import SILENT_NS, Sender, open_uplink, taken_up
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.work import Requests, Work

_REMEMBERED = 256


def make(bus: Bus, config: Config) -> UplinkWork:
    """The uplink's work, its port open."""
    outside, door = open_uplink(config, bus.log.seldom)
    return UplinkWork(bus, config, outside, door)


class UplinkWork(Work):
    """Sends the newest input up, and passes on what comes down after checking it."""

    def __init__(self, bus: Bus, config: Config, outside: zenoh.Session, door: Door) -> None:
        self._bus, self._outside, self._door = bus, outside, door
        self._host = config.other_host
        self._far = {*config.far, "downlink"}
        keys, inbox = bus.keys, bus.inbox
        self._found_key, self._kind = taken_up(config)
        self._requests = Requests(bus, looks=False) if self._kind is Look else None
        self._found = None if self._kind is Look else inbox.ring(self._found_key)
        self._objects = inbox.ring(keys.objects)
        self._answers = inbox.queue(keys.down(keys.estimates), session=outside)
        self._health = inbox.queue(keys.down(keys.health()), session=outside)
        self._sender = Sender(outside, keys.up(self._found_key))
        self._up_objects = outside.declare_publisher(keys.up(keys.objects))
        self._sent: dict[tuple[int, int], int] = {}
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self._heard: dict[str, int] = {}
        self._began_ns = self._next_look_ns = now_ns()

    def due_ns(self) -> int | None:
        """When to check again which workers are there; soon, while a request waits for a newer frame."""
        asked_ns = None if self._requests is None else self._requests.due_ns()
        return self._next_look_ns if asked_ns is None else min(self._next_look_ns, asked_ns)

    def step(self) -> None:
        """Pass on what has arrived."""
        bus, keys = self._bus, self._bus.keys
        if (taken := self._newest()) is not None:
            self._send(*taken)
        while not self._sender.sent.empty():
            bus.health.worked_on(*self._sender.sent.get())
            bus.health.count("sent")
        if (objects := bus.take(self._objects, ObjectsMessage)) is not None:
            self._up_objects.put(encode(objects))
        while (answer := bus.take(self._answers, Estimates, foreign=True)) is not None:
            if self._sent.get((answer.camera_epoch, answer.frame_id)) == answer.capture_ns:
                bus.put_control(keys.estimates, replace(answer, publish_ns=now_ns()))
                bus.health.count("answers")
            else:
                bus.health.count("answers_about_frames_not_sent")
        while (health := bus.take(self._health, HealthMessage, foreign=True)) is not None:
            if health.worker in self._far:
                self._heard[health.worker] = now_ns()
                bus.put(keys.health(health.worker), replace(health, publish_ns=now_ns()))
        if (now := now_ns()) >= self._next_look_ns:
            self._next_look_ns = now + SECOND // 4
            self._look(now)

    def _newest(self) -> tuple[Look | Detections | Masks, FrameHeader, bytes] | None:
        if self._found is not None:
            taken = self._bus.take_with_payload(self._found, self._kind)
            return None if taken is None else (taken[0], taken[0].frame, taken[1])
        if self._requests is None or (asked := self._requests.take()) is None:
            return None
        request, frame, payload = asked
        return Look(publish_ns=now_ns(), request=request, frame=frame), frame, payload

    def _send(self, message: Look | Detections | Masks, frame: FrameHeader, payload: bytes) -> None:
        health = self._bus.health
        self._sent[frame.camera_epoch, frame.frame_id] = frame.capture_ns
        if len(self._sent) > _REMEMBERED:
            del self._sent[next(iter(self._sent))]
        self._sender.offer(frame, encode(message), payload)
        health.counters["replaced"] = self._sender.replaced

    def _look(self, now: int) -> None:
        """Find out which workers of the other computer are there, and show them on this bus (`huepose
        status`)."""
        bus = self._bus
        there = {worker for worker, heard_ns in self._heard.items() if now - heard_ns <= SILENT_NS}
        for worker in there - self._tokens.keys():
            key = bus.keys.live(worker)
            self._tokens[worker] = bus.session.liveliness().declare_token(key)
        for worker in self._tokens.keys() - there:
            self._tokens.pop(worker).undeclare()
        bus.health.counters["refused_readers"] = self._door.refused
        silent_s = (now - max(self._heard.values(), default=self._began_ns)) * 1e-9
        if there or silent_s * SECOND <= SILENT_NS:
            bus.health.warn_while("link", None)
            if there and bus.health.state == "waiting":
                bus.health.state = "ready"
                bus.log.say(f"{self._host} is there again")
            return
        text = f"{self._host} has sent nothing for {silent_s:.0f} s: {_WITHOUT}"
        if bus.health.state != "waiting":
            bus.log.warn(text)
        bus.health.state = "waiting"
        bus.health.warn_while("link", text)

    def close(self) -> None:
        """Close the connection to the other computer."""
        self._sender.close()
        self._door.close()
        self._outside.close()


_WITHOUT = (
    "tracked objects stay tracked; lost or new ones are not found until the link is back (is the other "
    "computer on, its pipeline running, the cable plugged in?)"
)
