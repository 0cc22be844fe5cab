"""Listens to a running pipeline and writes what it hears, until the pipeline's end."""

from __future__ import annotations

import platform
import time
from importlib.metadata import PackageNotFoundError, version

import msgspec

from huepose.support.errors import InputError
from huepose_protos import WireError
from huepose_protos.buffers import frame_images
from huepose_protos.client import kind_of
from huepose_protos.messages import FrameHeader, MemoryMessage, Message
from huepose_services import models
from huepose_services.recording.parts import Parts
from huepose_services.runtime.bus import Bus, Place
from huepose_services.runtime.config import Config

_GONE_AFTER_S = 1.0
_FRAMES_WAITING = 128
"""Frames that a slow disk may leave waiting, 190 MB at 640 x 480."""
_PACKAGES = ("huepose", "numpy", "numba", "opencv-python-headless")


def about_this_machine() -> dict[str, str]:
    """What poses may depend on in their last bits."""
    about = {"python": platform.python_version(), "machine": platform.machine(), "cpu": _cpu()}
    return about | {name: _version(name) for name in _PACKAGES}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _cpu() -> str:
    try:
        with open("/proc/cpuinfo") as file:
            return next(line.split(":")[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration, IndexError):
        return platform.processor() or "unknown"


class Recorder:
    """One recording. `finished` says why it is over: the pipeline is gone."""

    def __init__(self, bus: Bus, parts: Parts, with_frames: bool) -> None:
        self._bus, self._parts = bus, parts
        keys, inbox = bus.keys, bus.inbox
        # Frames first: what the tracker took in then comes after the frame that it took.
        self._frames = inbox.queue(keys.frame, True, _FRAMES_WAITING, copies=True) if with_frames else None
        said = (
            *(keys.truth, keys.camera_info, keys.request, keys.estimates, keys.correction, keys.objects),
            *(keys.poses, keys.health()),
            *((keys.intake, keys.memory) if with_frames else ()),
        )
        self._queues: list[tuple[Place, type[Message]]] = [
            (inbox.queue(key, wakes=False), kind) for key in said if (kind := kind_of(key)) is not None
        ]
        self._live = inbox.liveliness(keys.live())
        self._there: set[str] = set()
        self._gone_since: float | None = None
        self._digests: dict[str, str] = {}
        self.finished = ""
        self.first_ns: int | None = None
        self.last_ns = 0

    @property
    def seconds(self) -> float:
        """From the first to the last thing that was recorded."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) * 1e-9

    @property
    def missed(self) -> int:
        """Messages, most of them frames, that came and were not written."""
        return self._bus.inbox.drops

    def step(self) -> None:
        """Write what arrived. Raises OSError for a full disk."""
        while self._frames is not None:
            taken = self._bus.take_with_payload(self._frames, FrameHeader)
            if taken is None:
                break
            self._frame(*taken)
            self._parts.commit()
        for place, kind in self._queues:
            while (said := self._bus.take_with_key(place, kind)) is not None:
                self._said(*said)
        self._parts.commit()
        self._look_who_is_there()

    def _frame(self, header: FrameHeader, payload: bytes) -> None:
        try:
            color, depth = frame_images(header, payload)
        except WireError as error:
            self._bus.refuse(self._bus.keys.frame, error)
            return
        self._parts.frame(header, color, depth, self._bus.keys.frame)
        self._saw(header.publish_ns)

    def _said(self, key: str, message: Message) -> None:
        if isinstance(message, MemoryMessage):
            self._note_models(message)
        self._parts.message(key, message)
        self._saw(message.publish_ns)

    def _note_models(self, message: MemoryMessage) -> None:
        """Who computes the poses again needs the same reference models."""
        fresh = [name for name in message.objects if name not in self._digests]
        if fresh:
            try:
                config = msgspec.json.decode(message.config, type=Config)
                self._digests |= models.digests(config, fresh)
            except (msgspec.MsgspecError, InputError) as error:
                self._digests |= dict.fromkeys(fresh, "")
                self._bus.log.warn(f"reference models are not noted: {error}")
            self._parts.note("models", self._digests)

    def _saw(self, stamp_ns: int) -> None:
        self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
        self.last_ns = max(self.last_ns, stamp_ns)

    def _look_who_is_there(self) -> None:
        import zenoh

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
