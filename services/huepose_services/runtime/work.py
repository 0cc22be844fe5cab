"""The interface of a worker's work to its process (`runtime.worker`), and the requests to perception."""

from __future__ import annotations

from huepose.support.errors import InputError
from huepose_protos.messages import FrameHeader, Look, PerceptionRequest
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config

_SOON_NS = SECOND // 50
"""How often to look for a frame, whose arrival does not wake the loop, while a request waits for it."""


class Work:
    """Made by `make(bus, config)` of a worker's module, which warms it up."""

    finished = False
    """Set when there is nothing left to do: the worker then ends, with exit code 0 if there is no `fault`."""
    fault: InputError | None = None
    """If it is finished because of an error: what is wrong with its input."""
    ready = True
    """Read after every step: while it is False, the worker does not report that it is ready (a camera before
    its first good frame)."""

    def step(self) -> None:
        """Do what is due: called when something has arrived, at `due_ns`, and from time to time."""
        raise NotImplementedError

    def due_ns(self) -> int | None:
        """The latest time for the next call of `step`; None: only when something arrives."""
        return None

    def reload(self, config: Config) -> list[str]:
        """Take over changes of the configuration (`reload.LIVE`); returns sentences on those that cannot
        be."""
        return []

    def close(self) -> None:
        """Release all that is not on the bus: a camera that is not released has to be plugged in again."""
        return None


class Requests:
    """The requests to perception, each with the newest frame, which may be the same again if the camera has
    stopped. looks: a request may also come with its frame, from another computer."""

    def __init__(self, bus: Bus, looks: bool) -> None:
        self._bus = bus
        self._requests = bus.inbox.queue(bus.keys.request)
        self._looks = bus.inbox.ring(bus.keys.look) if looks else None
        self._frames = bus.frames(wakes=False)
        self._frame: tuple[FrameHeader, bytes] | None = None
        self._waiting: PerceptionRequest | None = None

    def due_ns(self) -> int | None:
        """Soon, while a request waits for a frame."""
        return None if self._waiting is None else now_ns() + _SOON_NS

    def take(self) -> tuple[PerceptionRequest, FrameHeader, bytes] | None:
        """The newest request, once, with a frame and its pixels; None if there is no request, or it waits
        for a frame or a newer one."""
        while (newer := self._bus.take(self._requests, PerceptionRequest)) is not None:
            self._waiting = newer
        with_frame = None if self._looks is None else self._bus.take_with_payload(self._looks, Look)
        if with_frame is not None:
            look, payload = with_frame
            self._waiting, self._frame = look.request, (look.frame, payload)
        if (request := self._waiting) is None:
            return None
        self._frame = self._bus.take_with_payload(self._frames, FrameHeader) or self._frame
        if self._frame is None:
            return None
        header, payload = self._frame
        if request.seen == (header.camera_epoch, header.frame_id):
            return None
        self._waiting = None
        return request, header, payload
