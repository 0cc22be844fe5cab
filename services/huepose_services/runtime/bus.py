"""The bus as a worker sees it: typed messages in and out, bad bytes counted and dropped."""

from __future__ import annotations

from typing import Any, TypeVar

import zenoh

from huepose_protos import WireError, decode, encode
from huepose_protos.keys import Keys
from huepose_protos.messages import Message
from huepose_services.runtime.health import Health
from huepose_services.runtime.inbox import Inbox, Queue, Ring
from huepose_services.runtime.log import Log

M = TypeVar("M", bound=Message)
Place = Ring | Queue


class Bus:
    """Publishers, subscriptions, log and health of one worker."""

    def __init__(self, session: zenoh.Session, keys: Keys, worker: str, log: Log, health: Health) -> None:
        self.session, self.keys, self.worker = session, keys, worker
        self.log, self.health = log, health
        self.inbox = Inbox(session)
        self._publishers: dict[str, zenoh.Publisher] = {}

    def take(self, place: Place, kind: type[M]) -> M | None:
        """The next good message there, or None."""
        while (sample := place.take()) is not None:
            message = self._decoded(str(sample.key_expr), sample.payload.to_bytes(), kind)
            if message is not None:
                return message
        return None

    def _decoded(self, key: str, data: bytes, kind: type[M]) -> M | None:
        try:
            return decode(data, kind)
        except WireError as error:
            self.refuse(key, error)
            return None

    def take_with_payload(self, place: Place, kind: type[M]) -> tuple[M, bytes] | None:
        """The next good header there, with its payload copied out; the sample is dropped at once."""
        while (sample := place.take()) is not None:
            key = str(sample.key_expr)
            header = b"" if sample.attachment is None else sample.attachment.to_bytes()
            shared = sample.payload.as_shm() is not None
            payload = sample.payload.to_bytes()
            del sample
            message = self._decoded(key, header, kind)
            if message is None:
                continue
            if key == self.keys.frame:
                self.health.shared_memory = shared
                self.health.count("frames_by_shared_memory" if shared else "frames_by_tcp")
            return message, payload
        return None

    def refuse(self, key: str, error: WireError) -> None:
        """Count a bad message, and say so once a second at most."""
        text = f"dropped a message on {key}: {error.reason}"
        self.health.count("wire_errors")
        self.health.failed(text)
        self.log.seldom("wire", text)

    def say_health(self) -> None:
        """Publish how the worker is."""
        self.health.drops = self.inbox.drops
        self.put(self.keys.health(self.worker), self.health.message())

    def put(self, key: str, message: Message) -> None:
        """Publish a message that may be lost on a reader that does not read, but waits for nobody."""
        drop = zenoh.CongestionControl.DROP
        self._publisher(key, drop, zenoh.Priority.REAL_TIME, True).put(encode(message))

    def put_control(self, key: str, message: Message) -> None:
        """Publish a message that must arrive, before all others."""
        block = zenoh.CongestionControl.BLOCK
        self._publisher(key, block, zenoh.Priority.REAL_TIME, True).put(encode(message))

    def put_pixels(self, key: str, header: Message, payload: bytes) -> None:
        """Publish pixels with their header beside them; a reader that is behind loses them."""
        publisher = self._publisher(key, zenoh.CongestionControl.DROP, zenoh.Priority.DATA, False)
        publisher.put(payload, attachment=encode(header))

    def _publisher(self, key: str, congestion: Any, priority: Any, express: bool) -> zenoh.Publisher:
        if key not in self._publishers:
            self._publishers[key] = self.session.declare_publisher(
                key, congestion_control=congestion, priority=priority, express=express
            )
        return self._publishers[key]

    def close(self) -> None:
        """End all subscriptions and publishers."""
        self.inbox.close()
        for publisher in self._publishers.values():
            publisher.undeclare()
        self._publishers.clear()
