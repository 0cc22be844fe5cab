"""The bus as a worker sees it: typed messages in and out, bad bytes counted and dropped."""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec
import zenoh

from huepose_protos import WireError, decode, encode
from huepose_protos.keys import Keys, last
from huepose_protos.messages import Message
from huepose_services.runtime.clock import check_stamps, now_ns
from huepose_services.runtime.health import Health
from huepose_services.runtime.inbox import Inbox, Place
from huepose_services.runtime.log import Log
from huepose_services.runtime.one_camera import OneCamera

M = TypeVar("M", bound=Message)
_FOREIGN_FRAMES = (
    "frames of a second camera arrive under the key of this one, and are left out: another program publishes "
    "there; end it, or give its camera another name"
)


class FrameStamp(msgspec.Struct):
    """The epoch, number and capture time of a frame: all that is read of a header before it is decoded."""

    camera_epoch: int
    frame_id: int
    capture_ns: int = 0


_stamp_decoder = msgspec.msgpack.Decoder(FrameStamp)


def stamp_of(header: bytes) -> FrameStamp | None:
    """The FrameStamp of a frame's header; None for bytes that are no header."""
    try:
        return _stamp_decoder.decode(header)
    except (msgspec.MsgspecError, RecursionError):
        return None


def bytes_of(data: zenoh.ZBytes | None) -> bytes:
    """A payload or an attachment as bytes; empty if there is none."""
    return b"" if data is None else data.to_bytes()


def is_heard(publisher: zenoh.Publisher) -> bool:
    """Whether a publisher has a subscriber."""
    status: Any = publisher.matching_status  # zenoh's stubs take it for a bool
    return bool(status.matching)


class Bus:
    """Publishers, subscriptions, log and health of one worker."""

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        worker: str,
        log: Log | None = None,
        health: Health | None = None,
    ) -> None:
        self.session, self.keys, self.worker = session, keys, worker
        self.log, self.health = log or Log(worker), health or Health(worker)
        self.inbox = Inbox(session)
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._camera = OneCamera()
        self._foreign = (0, 0)
        self._newest = (0, 0)
        self._out_of_order = 0

    def frames(self, wakes: bool = True) -> Place:
        """The newest frame of the camera. Frames of a second camera under the same key, and frames older than
        one that came before, are counted and left out."""
        return self.inbox.ring(self.keys.frame, wakes, self._is_news)

    def _is_news(self, sample: zenoh.Sample) -> bool:
        stamp = stamp_of(bytes_of(sample.attachment))
        if stamp is None:
            return True  # no header: it is refused and counted when it is taken
        now = now_ns()
        if not self._camera.accepts(stamp.camera_epoch, stamp.capture_ns, now):
            return False
        if stamp.camera_epoch == self._newest[0] and stamp.capture_ns < self._newest[1]:
            self._out_of_order += 1
            return False
        # A timestamp in the future counts as now: else it would keep out all frames before it.
        self._newest = (stamp.camera_epoch, min(stamp.capture_ns, now))
        return True

    def take(self, place: Place, kind: type[M], foreign: bool = False) -> M | None:
        """The next good message there, or None. foreign: its timestamps may be of another clock."""
        while (sample := place.take()) is not None:
            message = self._decoded(str(sample.key_expr), sample.payload.to_bytes(), kind, foreign)
            if message is not None:
                return message
        return None

    def _decoded(self, key: str, data: bytes, kind: type[M], foreign: bool) -> M | None:
        try:
            message = decode(data, kind)
            if not foreign:
                check_stamps(message, now_ns())
            return message
        except WireError as error:
            self.refuse(key, error)
            return None

    def take_with_payload(self, place: Place, kind: type[M], foreign: bool = False) -> tuple[M, bytes] | None:
        """The next good header there, with its payload copied out; the sample is dropped at once. foreign:
        as for `take`."""
        while (sample := place.take()) is not None:
            key = str(sample.key_expr)
            header = bytes_of(sample.attachment)
            shared = sample.payload.as_shm() is not None
            payload = sample.payload.to_bytes()
            del sample
            message = self._decoded(key, header, kind, foreign)
            if message is None:
                continue
            if key == self.keys.frame:
                self.health.shared_memory = shared
                self.health.count("frames_by_shared_memory" if shared else "frames_by_socket")
            return message, payload
        return None

    @staticmethod
    def take_begun(tokens: Place) -> str | None:
        """The next worker that has started, by its liveliness token; None if there are no more."""
        while (sample := tokens.take()) is not None:
            if sample.kind == zenoh.SampleKind.PUT:
                return last(str(sample.key_expr))
        return None

    def refuse(self, key: str, error: WireError) -> None:
        """Count a bad message, and log it; repeats are held back."""
        text = f"dropped a message on {key}: {error}"
        self.health.count("wire_errors")
        self.health.failed(text)
        self.log.seldom("wire", text)

    def say_health(self) -> None:
        """Publish the worker's health."""
        self.health.drops = self.inbox.drops
        if self._camera.refused:
            self._say_foreign_frames()
        if self._out_of_order:
            self.health.counters["frames_out_of_order"] = self._out_of_order
        self.put(self.keys.health(self.worker), self.health.message())
        self.log.flush()

    def _say_foreign_frames(self) -> None:
        """Warn only if such frames go on: a camera that is opened again sends a few before its old epoch
        counts as silent."""
        refused = self._camera.refused
        self.health.counters["frames_of_another_camera"] = refused
        go_on = refused > self._foreign[1] > self._foreign[0]
        self._foreign = (self._foreign[1], refused)
        self.health.warn_while("foreign frames", _FOREIGN_FRAMES if go_on else None)

    def put(self, key: str, message: Message) -> None:
        """Publish a message without waiting for any reader; a reader that is behind may lose it."""
        self._publisher(key, zenoh.Priority.REAL_TIME).put(encode(message))

    def put_aside(self, key: str, message: Message) -> None:
        """Publish a message that is not urgent: others go before it."""
        self._publisher(key).put(encode(message))

    def is_heard(self, key: str) -> bool:
        """Whether anybody subscribes to what `put_aside` publishes there."""
        return is_heard(self._publisher(key))

    def put_control(self, key: str, message: Message) -> None:
        """Publish a message that must arrive, before all others."""
        block = zenoh.CongestionControl.BLOCK
        self._publisher(key, zenoh.Priority.REAL_TIME, block).put(encode(message))

    def put_pixels(self, key: str, header: Message, payload: bytes) -> None:
        """Publish pixels with their header as attachment; a reader that is behind loses them."""
        self._publisher(key).put(payload, attachment=encode(header))

    def _publisher(
        self,
        key: str,
        priority: zenoh.Priority = zenoh.Priority.DATA,
        congestion: zenoh.CongestionControl = zenoh.CongestionControl.DROP,
    ) -> zenoh.Publisher:
        if key not in self._publishers:
            express = priority == zenoh.Priority.REAL_TIME
            self._publishers[key] = self.session.declare_publisher(
                key, congestion_control=congestion, priority=priority, express=express
            )
        return self._publishers[key]

    def forget(self, under: str) -> None:
        """End the publishers of all keys below this one."""
        for key in [key for key in self._publishers if key.startswith(f"{under}/")]:
            self._publishers.pop(key).undeclare()

    def close(self) -> None:
        """End all subscriptions and publishers."""
        self.inbox.close()
        for publisher in self._publishers.values():
            publisher.undeclare()
        self._publishers.clear()
