"""The downlink worker, on the other computer: publishes on its own bus what the camera's computer sends up,
and sends answers and health down."""

from __future__ import annotations

import threading

import zenoh
from msgspec.structs import replace

from huepose_protos import encode
from huepose_protos.messages import Estimates, HealthMessage, ObjectsMessage
from huepose_protos.reach import address_of, why_unreachable
from huepose_services.link import credentials, open_downlink, taken_up
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.work import Work

_LOOK_NS, _ASK_WHY_NS = SECOND, 10 * SECOND


def make(bus: Bus, config: Config) -> DownlinkWork:
    """The downlink's work."""
    return DownlinkWork(bus, config, open_downlink(config))


class DownlinkWork(Work):
    """Passes messages on in both directions."""

    def __init__(self, bus: Bus, config: Config, outside: zenoh.Session) -> None:
        self._bus, self._config, self._outside = bus, config, outside
        keys, inbox = bus.keys, bus.inbox
        self._key, self._kind = taken_up(config)
        self._pixels = inbox.ring(keys.up(self._key), session=outside)
        self._objects = inbox.ring(keys.up(keys.objects), session=outside)
        self._answers = inbox.queue(keys.estimates)
        self._health = inbox.queue(keys.health())
        self._next_look_ns, self._next_why_ns = now_ns() + _LOOK_NS, now_ns() + 3 * _LOOK_NS
        self._why: str | None = None

    def due_ns(self) -> int | None:
        """When to check again whether the camera's computer is connected."""
        return self._next_look_ns

    def step(self) -> None:
        """Pass on what has arrived."""
        bus, keys, started = self._bus, self._bus.keys, now_ns()
        if (taken := bus.take_with_payload(self._pixels, self._kind, foreign=True)) is not None:
            message, payload = taken
            bus.put_pixels(self._key, replace(message, publish_ns=now_ns()), payload)
            bus.health.worked_on(started, message.frame)
        if (objects := bus.take(self._objects, ObjectsMessage, foreign=True)) is not None:
            bus.put(keys.objects, replace(objects, publish_ns=now_ns()))
        while (answer := bus.take(self._answers, Estimates, foreign=True)) is not None:
            self._outside.put(keys.down(keys.estimates), encode(answer))
            bus.health.count("answers")
        while (health := bus.take(self._health, HealthMessage)) is not None:
            self._outside.put(keys.down(keys.health(health.worker)), encode(health))
        if (now := now_ns()) >= self._next_look_ns:
            self._next_look_ns = now + _LOOK_NS
            self._look(now)

    def _look(self, now: int) -> None:
        health = self._bus.health
        if self._outside.info.peers_zid():
            health.state, self._why = "ready", None
        else:
            health.state = "waiting"
            if now >= self._next_why_ns:
                self._next_why_ns = now + _ASK_WHY_NS
                threading.Thread(target=self._ask_why, daemon=True).start()
        health.warn_while("link", self._why)

    def _ask_why(self) -> None:
        """Find out why there is no connection; takes seconds if nothing answers."""
        host, port = address_of(str(self._config.link.connect))
        why = why_unreachable(host, port, credentials(self._config).context()) or "it does not answer"
        self._why = f"waiting for the camera's computer at {host}:{port}: {why}"
        self._bus.log.seldom("link", self._why)

    def close(self) -> None:
        """Close the connection to the camera's computer."""
        self._outside.close()
