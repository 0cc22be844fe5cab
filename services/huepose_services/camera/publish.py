"""Puts pictures on the bus as frames, and says once a second what the camera is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from huepose.datasets.types import GroundTruth
from huepose.geometry import RgbdFrame
from huepose.geometry.picture_faults import camera_doubted
from huepose_protos.buffers import pack
from huepose_protos.messages import (
    BufferSpec,
    CameraMessage,
    FrameHeader,
    Intrinsics,
    Mount,
    MountMessage,
    TruthMessage,
    TruthObject,
)
from huepose_protos.motion import composed
from huepose_services.convert import camera_from_wire, depth_to_wire, intrinsics_to_wire, to_wire
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns, this_clock
from huepose_services.runtime.config import Config
from huepose_services.runtime.inbox import Place
from huepose_services.runtime.text import encodable

_LATE_NS = SECOND // 2
_NOT_TOLD = (
    "nobody has told for half a second where the camera is (camera.moving, camera.tf): there are no poses in "
    "the frame of the robot; MountSender of huepose_protos tells it, or /tf by the worker ros2"
)


@dataclass(frozen=True)
class Packed:
    """A picture that is ready to go. truths: what its source knows about it, None where nobody is told;
    scene, image: which picture of the source it is."""

    intrinsics: Intrinsics
    buffers: list[BufferSpec]
    payload: bytes
    truths: Sequence[GroundTruth] | None
    scene: str
    image: int


def packed(
    frame: RgbdFrame,
    depth_scale_m: float,
    truths: Sequence[GroundTruth] | None = None,
    scene: str = "",
    image: int = 0,
) -> Packed:
    """Colour and depth as they travel, depth in steps of depth_scale_m."""
    depth = depth_to_wire(frame.depth, depth_scale_m)
    buffers, payload = pack({"color": frame.color, "depth": depth})
    intrinsics = intrinsics_to_wire(frame.camera, depth_scale_m)
    return Packed(intrinsics, buffers, payload, truths, encodable(scene), image)


class FramePublisher:
    """The camera's side of the bus."""

    def __init__(self, bus: Bus, config: Config) -> None:
        self._bus, self._keys = bus, config.keys
        self._frame_name = config.camera.frame
        self._mount = config.camera.mount
        self._told_mounts = bus.inbox.queue(self._keys.mount, wakes=False) if config.camera.told else None
        self._placed_ns = now_ns()
        self._told: int | None = None
        self._tell_ns = 0

    def publish(
        self,
        picture: Packed,
        epoch: int,
        frame_id: int,
        capture_ns: int,
        counted_as: str = "frames",
        said: tuple[str, str] = ("", ""),
    ) -> None:
        """One frame, counted and timed in health, after the truth about it. said: what is wrong with the
        picture and with the camera (`picture` and `camera` of the header)."""
        if picture.truths is not None:
            truth = TruthMessage(
                publish_ns=now_ns(),
                camera_epoch=epoch,
                frame_id=frame_id,
                capture_ns=capture_ns,
                scene=picture.scene,
                image=picture.image,
                objects=[to_wire(TruthObject, truth) for truth in picture.truths],
            )
            self._bus.put(self._keys.truth, truth)
        bus, started = self._bus, now_ns()
        header = FrameHeader(
            publish_ns=started,
            camera_epoch=epoch,
            frame_id=frame_id,
            capture_ns=capture_ns,
            clock=this_clock(),
            frame=self._frame_name,
            intrinsics=picture.intrinsics,
            buffers=picture.buffers,
            picture=said[0],
            camera=said[1],
        )
        bus.put_pixels(self._keys.frame, header, picture.payload)
        if epoch != self._told:
            doubt = camera_doubted(camera_from_wire(picture.intrinsics))
            bus.health.warn_while("matrix", doubt)
            if doubt is not None:
                bus.log.say(doubt)
        self._tell(header)
        if self._told_mounts is not None:
            self._tell_mounts(header, self._told_mounts)
        bus.health.count(counted_as)
        bus.health.worked_on(started, header)

    def _tell(self, header: FrameHeader) -> None:
        """Which camera is open, for readers that take no frames: when it is new, and then once a second."""
        now = now_ns()
        if header.camera_epoch == self._told and now < self._tell_ns:
            return
        self._told, self._tell_ns = header.camera_epoch, now + SECOND
        self._say(header, self._mount if self._told_mounts is None else None, None)

    def _tell_mounts(self, header: FrameHeader, told: Place) -> None:
        """Where a camera that moves was, as it was told since the last frame."""
        while (message := self._bus.take(told, MountMessage)) is not None:
            self._placed_ns = message.capture_ns
            fixed = self._mount
            mount = message.mount if fixed is None else composed(message.mount, fixed)
            self._say(header, mount, message.capture_ns)
        late = now_ns() - self._placed_ns > _LATE_NS
        self._bus.health.warn_while("mount", _NOT_TOLD if late else None)

    def _say(self, header: FrameHeader, mount: Mount | None, mount_ns: int | None) -> None:
        message = CameraMessage(
            publish_ns=now_ns(),
            camera_epoch=header.camera_epoch,
            clock=header.clock,
            frame=header.frame,
            intrinsics=header.intrinsics,
            mount=mount,
            mount_ns=mount_ns,
        )
        self._bus.put(self._keys.camera_info, message)
