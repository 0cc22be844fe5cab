"""Says which camera is open, once a second, for readers that take no frames."""

from __future__ import annotations

from huepose_protos.messages import CameraMessage, FrameHeader, Mount
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns


class CameraInfo:
    """Publishes a CameraMessage when the camera is new, and then once a second while there are frames."""

    def __init__(self, bus: Bus, mount: Mount | None) -> None:
        self._bus, self._mount = bus, mount
        self._epoch: int | None = None
        self._next_ns = 0

    def tell(self, header: FrameHeader) -> None:
        """Of the camera of a frame that is published now."""
        now = now_ns()
        if header.camera_epoch == self._epoch and now < self._next_ns:
            return
        self._epoch, self._next_ns = header.camera_epoch, now + SECOND
        message = CameraMessage(
            publish_ns=now,
            camera_epoch=header.camera_epoch,
            clock=header.clock,
            frame=header.frame,
            intrinsics=header.intrinsics,
            mount=self._mount,
        )
        self._bus.put(self._bus.keys.camera_info, message)
