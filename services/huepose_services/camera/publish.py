"""Puts pictures on the bus as frames, and says once a second what the camera is."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from huepose.datasets.types import GroundTruth
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64
from huepose.geometry.picture_faults import camera_doubted
from huepose_protos.buffers import pack
from huepose_protos.fields import Quaternion, Vector3
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
from huepose_protos.motion import composed, mount_at
from huepose_services.convert import (
    camera_from_wire,
    check_size,
    depth_to_wire,
    frame_key,
    optional_pose_to_wire,
    to_wire,
)
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns, this_clock
from huepose_services.runtime.config import Config
from huepose_services.runtime.text import encodable

_LATE_NS = SECOND // 2
_BACK_NS = SECOND // 2
"""What was told of an earlier time than the last, by no more than this, came late and is left out."""
_PLACES = 256
"""So many are remembered: of a robot that tells a thousand a second those of the last quarter of one."""
_NOT_TOLD = (
    "nobody has told for half a second where the camera is (camera.moving, camera.tf): there are no poses in "
    "the frame of the robot; MountSender of huepose_protos tells it, or /tf by the worker ros2"
)


@dataclass(frozen=True)
class Packed:
    """A picture that is ready to go. T_parent_cam (4, 4): where its source says that the camera was, None
    where it does not know; truths: what it knows about it, None where nobody is told; scene, image: which
    picture of the source it is."""

    intrinsics: Intrinsics
    buffers: list[BufferSpec]
    payload: bytes
    T_parent_cam: Float64 | None
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
    """Colour and depth as they travel, depth in steps of depth_scale_m. Raises InputError for a picture that
    is too large to."""
    check_size(frame.camera)
    depth = depth_to_wire(frame.depth, depth_scale_m)
    buffers, payload = pack({"color": frame.color, "depth": depth})
    intrinsics = to_wire(Intrinsics, frame.camera, depth_scale_m=depth_scale_m)
    place = frame.T_parent_cam
    return Packed(intrinsics, buffers, payload, place, truths, encodable(scene), image)


class FramePublisher:
    """The camera's side of the bus."""

    def __init__(self, bus: Bus, config: Config) -> None:
        self._bus, self._keys = bus, config.keys
        self._frame_name = config.camera.frame
        self._mount = config.camera.mount
        self._told_mounts = bus.inbox.queue(self._keys.mount, wakes=False) if config.camera.told else None
        self._placed_ns = now_ns()
        self._places: deque[tuple[int, Mount]] = deque(maxlen=_PLACES)
        self._told: int | None = None
        self._tell_ns = 0
        self._last: FrameHeader | None = None

    def publish(
        self,
        picture: Packed,
        epoch: int,
        frame_id: int,
        capture_ns: int,
        counted_as: str = "frames",
        said: tuple[str, str] = ("", ""),
    ) -> None:
        """One frame, counted and timed in health, after the truth about it; the last one once more with the
        header that it had. said: what is wrong with the picture and with the camera (`picture` and `camera`
        of the header)."""
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
        news = self._heard()
        last = self._last
        if last is not None and frame_key(last) == (epoch, frame_id):
            # Of one frame all readers, and a recording, must have the same.
            header = msgspec.structs.replace(last, publish_ns=started)
        else:
            translation, quaternion = self._place(picture, capture_ns)
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
                camera_translation=translation,
                camera_quaternion=quaternion,
            )
        self._last = header
        bus.put_pixels(self._keys.frame, header, picture.payload)
        if epoch != self._told:
            doubt = camera_doubted(camera_from_wire(picture.intrinsics))
            bus.health.warn_while("matrix", doubt)
            if doubt is not None:
                bus.log.say(doubt)
        self._tell(header)
        for mount_ns, told in news:
            self._say(header, self._of_camera(told), mount_ns)
        bus.health.count(counted_as)
        bus.health.worked_on(started, header)

    def _tell(self, header: FrameHeader) -> None:
        """Which camera is open, for readers that take no frames: when it is new, and then once a second."""
        now = now_ns()
        if header.camera_epoch == self._told and now < self._tell_ns:
            return
        self._told, self._tell_ns = header.camera_epoch, now + SECOND
        self._say(header, self._mount if self._told_mounts is None else None, None)

    def _heard(self) -> list[tuple[int, Mount]]:
        """Where a camera that moves, or what it is fixed to, was told to be since the last frame."""
        if self._told_mounts is None:
            return []
        news = []
        while (message := self._bus.take(self._told_mounts, MountMessage)) is not None:
            news.append((message.capture_ns, message.mount))
            self._remember(message.capture_ns, message.mount)
        late = now_ns() - self._placed_ns > _LATE_NS
        self._bus.health.warn_while("mount", _NOT_TOLD if late else None)
        return news

    def _remember(self, mount_ns: int, mount: Mount) -> None:
        """That it was there; a stamp that goes far back is of another clock or program, and begins anew."""
        if self._places and mount_ns < self._places[-1][0] - _BACK_NS:
            self._places.clear()
        if not self._places or mount_ns > self._places[-1][0]:
            self._places.append((mount_ns, mount))
            self._placed_ns = mount_ns

    def _place(self, picture: Packed, capture_ns: int) -> tuple[Vector3, Quaternion] | tuple[None, None]:
        """Where the camera took the picture: as somebody told, or the source while nobody does."""
        if not self._places:
            return optional_pose_to_wire(picture.T_parent_cam)
        told = mount_at(self._places, capture_ns)
        if told is None:
            return None, None
        mount = self._of_camera(told)
        return mount.translation, mount.quaternion

    def _of_camera(self, told: Mount) -> Mount:
        """Where the camera is, of where it, or what it is fixed to, was told to be."""
        return told if self._mount is None else composed(told, self._mount)

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
