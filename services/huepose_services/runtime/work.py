"""What a worker does, as its process sees it (`runtime.worker`); the requests that perception works on."""

from __future__ import annotations

from huepose.support.errors import InputError
from huepose_protos.messages import FrameHeader, Look, PerceptionRequest
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config

_SOON_NS = SECOND // 50
"""How often to look for a frame that does not wake the loop, while something waits for it."""


class Work:
    """Made by `make(bus, config)` of a worker's module, warmed up when that returns."""

    finished = False
    """Set when there is nothing left to do: the worker then ends, with exit code 0 if there is no `fault`."""
    fault: InputError | None = None
    """Why it has come to no good end, where it is finished: what was given to it does not work."""
    ready = True
    """Looked at after every step: as long as it is False, the worker does not say that it is ready (a camera
    before its first good frame)."""

    def step(self) -> None:
        """Do what is due: called when something arrived, when `due_ns` has come, and now and then."""
        raise NotImplementedError

    def due_ns(self) -> int | None:
        """When to be called at the latest; None to be called for arrivals only."""
        return None

    def reload(self, config: Config) -> list[str]:
        """Take over what of a changed configuration can be (`reload.LIVE`): sentences on what cannot."""
        return []

    def close(self) -> None:
        """Let go of all that is not on the bus: a camera that is not has to be plugged in anew."""
        return None


class Requests:
    """What perception is asked for, each with the newest frame, which may be looked at again when the camera
    stands still. looks: a request may also come with a frame of its own, from another computer."""

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
        """The newest request, once, with a frame and its pixels; None where there is none, or it waits for a
        frame, or for a newer one."""
        while (newer := self._bus.take(self._requests, PerceptionRequest)) is not None:
            self._waiting = newer
        brought = None if self._looks is None else self._bus.take_with_payload(self._looks, Look)
        if brought is not None:
            look, payload = brought
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
