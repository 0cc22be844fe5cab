"""Records the messages of a running pipeline, until its end."""

from __future__ import annotations

import platform
import time
from collections.abc import Iterator

import msgspec
import zenoh

from huepose.support.errors import InputError
from huepose.support.extras import installed_version
from huepose_protos import WireError, decode, encode
from huepose_protos.buffers import frame_images
from huepose_protos.client import kind_of
from huepose_protos.messages import AgainRequest, FrameHeader, IntakeMessage, MemoryMessage
from huepose_services import models
from huepose_services.recording.arrivals import Arrivals, Arrived, FrameKey
from huepose_services.recording.parts import GIVEN, Parts
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config

_GONE_AFTER_S = 1.0
_ANSWER_WITHIN_S = 2.0
_LOOK_EVERY_S = 0.5
_MOST_WAITING = 256 * 1024 * 1024
"""Bytes of pixels that may wait for a slow disk: six seconds at 640 x 480."""
_PACKAGES = ("huepose", "numpy", "numba", "opencv-python-headless")


def about_this_machine() -> dict[str, str]:
    """The properties of this machine on which the last bits of poses may depend."""
    about = {"python": platform.python_version(), "machine": platform.machine(), "cpu": _cpu()}
    return about | {name: installed_version(name) or "not installed" for name in _PACKAGES}


def _cpu() -> str:
    try:
        with open("/proc/cpuinfo") as file:
            return next(line.split(":")[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration, IndexError):
        return platform.processor() or "unknown"


class Span:
    """The time that a recording covers, by the timestamps of its messages. `older`: frames from before the
    recording, which were requested from the tracker."""

    def __init__(self) -> None:
        self.first_ns: int | None = None
        self.older = self._began_ns = self._last_ns = 0

    def saw(self, stamp_ns: int, now_ns: int, asked_for: bool = False) -> None:
        """A message with this timestamp is recorded now; asked_for: a frame that was requested from the
        tracker."""
        if self.first_ns is None:
            self._began_ns = now_ns
        self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
        self._last_ns = max(self._last_ns, stamp_ns)
        self.older += asked_for and stamp_ns < self._began_ns

    @property
    def seconds(self) -> float:
        """From the arrival of the first message to the last timestamp."""
        return max(self._last_ns - self._began_ns, 0) * 1e-9

    @property
    def before_s(self) -> float:
        """How much older the oldest message is than the recording: the tracker keeps such frames, and they
        are needed to compute the poses again."""
        return 0.0 if self.first_ns is None else max(self._began_ns - self.first_ns, 0) * 1e-9


class Recorder:
    """One recording. `finished` says why it has ended: the pipeline is gone; else it is empty."""

    def __init__(self, bus: Bus, parts: Parts, with_frames: bool) -> None:
        self._bus, self._parts = bus, parts
        keys = bus.keys
        recorded = (
            *(keys.truth, keys.camera_info, keys.request, keys.estimates, keys.correction, keys.objects),
            *(keys.poses, keys.health()),
            *((keys.frame, keys.intake, keys.memory) if with_frames else ()),
        )
        # In the order of arrival, so that the log of a tracker's step comes after the frame of that step.
        self._arrivals = Arrivals(bus.session, recorded, _MOST_WAITING, self._ask if with_frames else None)
        self._live = bus.inbox.liveliness(keys.live())
        self._there: set[str] = set()
        self._gone_since: float | None = None
        self._digests: dict[str, str] = {}
        self.finished = ""
        self._look_at = 0.0
        self.span = Span()

    @property
    def missed(self) -> int:
        """Frames that came and were not written."""
        return self._arrivals.missed

    @property
    def waiting(self) -> bool:
        """Whether messages came that are not written yet."""
        return self._arrivals.waiting

    @property
    def lost(self) -> int:
        """Frames and steps of the tracker that came neither by themselves nor on request."""
        return self._arrivals.taken.lost

    def _ask(self, frames: list[FrameKey], steps: list[int]) -> Iterator[zenoh.Sample]:
        request = AgainRequest(publish_ns=now_ns(), frames=frames, steps=steps)
        key, data = self._bus.keys.again, encode(request)
        for reply in self._bus.session.get(key, payload=data, timeout=_ANSWER_WITHIN_S):
            if reply.ok is not None:
                yield reply.ok

    def step(self, timeout_s: float) -> None:
        """Write what has arrived; waits up to timeout_s for the first message. Raises OSError for a full
        disk."""
        self._arrivals.wait(timeout_s)
        while (arrived := self._arrivals.take()) is not None:
            try:
                self._write(arrived)
            except WireError as error:
                self._bus.refuse(arrived.key, error)
            self._parts.commit()
            if time.monotonic() > self._look_at:
                break
        self._parts.commit()
        self._look_at = time.monotonic() + _LOOK_EVERY_S
        self._check_workers()

    def unsubscribe(self) -> None:
        """Let no more messages come; `step` writes those that wait."""
        self._arrivals.unsubscribe()

    def close(self) -> None:
        """End the subscriptions. Frames that still wait are missed."""
        self._arrivals.close()

    def _write(self, arrived: Arrived) -> None:
        keys = self._bus.keys
        if arrived.key == keys.frame or (arrived.key == keys.again and arrived.pixels):
            header = decode(arrived.header, FrameHeader)
            color, depth = frame_images(header, arrived.pixels)
            given = arrived.key == keys.again
            self._parts.frame(header, color, depth, keys.of_tail(GIVEN) if given else keys.frame)
            self.span.saw(header.publish_ns, now_ns(), given)
        elif arrived.key == keys.again:
            self._parts.message(keys.intake, decode(arrived.header, IntakeMessage))
        elif (kind := kind_of(arrived.key)) is not None:
            message = decode(arrived.header, kind)
            if isinstance(message, MemoryMessage):
                self._note_models(message)
            self._parts.message(arrived.key, message)
            self.span.saw(message.publish_ns, now_ns())

    def _note_models(self, message: MemoryMessage) -> None:
        """Note the digests of the reference models: computing the poses again needs the same models."""
        fresh = [name for name in message.objects if name not in self._digests]
        if fresh:
            try:
                config = msgspec.json.decode(message.config, type=Config)
                self._digests |= models.digests(config, fresh)
            except (msgspec.MsgspecError, InputError) as error:
                self._digests |= dict.fromkeys(fresh, "")
                self._bus.log.warn(f"reference models are not noted: {error}")
            self._parts.note("models", self._digests)

    def _check_workers(self) -> None:
        while (sample := self._live.take()) is not None:
            key = str(sample.key_expr)
            if sample.kind == zenoh.SampleKind.PUT:
                self._there.add(key)
                self._gone_since = None
            else:
                self._there.discard(key)
                self._gone_since = None if self._there else time.monotonic()
        if self._gone_since is not None and time.monotonic() - self._gone_since > _GONE_AFTER_S:
            self.finished = "the pipeline is gone"
