"""Publishes frames on the bus, and once a second the data of the camera."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from huepose.datasets.types import GroundTruth
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64
from huepose.geometry.image_faults import camera_doubted
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
"""A mount whose time is earlier than the last one's by no more than this came late and is left out."""
_KEPT_MOUNTS = 256
"""The number of mounts that are kept: a quarter of a second, if a robot sends a thousand a second."""
_NO_MOUNT = (
    "no camera pose was given for half a second (camera.moving, camera.tf), so there are no poses in the "
    "robot's frame; give it with MountSender of huepose_protos, or with /tf through the worker ros2"
)


@dataclass(frozen=True)
class Packed:
    """A frame that is ready to be published. T_parent_cam (4, 4): the camera pose that the source gives,
    None if it does not know it; truths: the ground truth, None if it is not published; scene, image: the
    image's scene and number in the source."""

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
    """Pack colour and depth as they are sent, depth in steps of depth_scale_m. Raises InputError for an
    image that is too large."""
    check_size(frame.camera)
    depth = depth_to_wire(frame.depth, depth_scale_m)
    buffers, payload = pack({"color": frame.color, "depth": depth})
    intrinsics = to_wire(Intrinsics, frame.camera, depth_scale_m=depth_scale_m)
    T_parent_cam = frame.T_parent_cam
    return Packed(intrinsics, buffers, payload, T_parent_cam, truths, encodable(scene), image)


class FramePublisher:
    """Publishes all messages of the camera worker except health."""

    def __init__(self, bus: Bus, config: Config) -> None:
        self._bus, self._keys = bus, config.keys
        self._frame_name = config.camera.frame
        self._mount = config.camera.mount
        self._mount_inbox = bus.inbox.queue(self._keys.mount, wakes=False) if config.camera.told else None
        self._newest_mount_ns = now_ns()
        self._mounts: deque[tuple[int, Mount]] = deque(maxlen=_KEPT_MOUNTS)
        self._announced: int | None = None
        self._announce_ns = 0
        self._last: FrameHeader | None = None

    def publish(
        self,
        packed_frame: Packed,
        epoch: int,
        frame_id: int,
        capture_ns: int,
        counted_as: str = "frames",
        faults: tuple[str, str] = ("", ""),
    ) -> None:
        """Publish the ground truth of a frame, if there is any, then the frame; health counts and times it.
        If the last frame is published again, it keeps its header. faults: of the image and of the camera
        (`picture` and `camera` of the header)."""
        if packed_frame.truths is not None:
            truth = TruthMessage(
                publish_ns=now_ns(),
                camera_epoch=epoch,
                frame_id=frame_id,
                capture_ns=capture_ns,
                scene=packed_frame.scene,
                image=packed_frame.image,
                objects=[to_wire(TruthObject, truth) for truth in packed_frame.truths],
            )
            self._bus.put(self._keys.truth, truth)
        bus, started = self._bus, now_ns()
        new_mounts = self._new_mounts()
        last = self._last
        if last is not None and frame_key(last) == (epoch, frame_id):
            # All readers and recordings must have the same header of a frame.
            header = msgspec.structs.replace(last, publish_ns=started)
        else:
            translation, quaternion = self._camera_pose(packed_frame, capture_ns)
            header = FrameHeader(
                publish_ns=started,
                camera_epoch=epoch,
                frame_id=frame_id,
                capture_ns=capture_ns,
                clock=this_clock(),
                frame=self._frame_name,
                intrinsics=packed_frame.intrinsics,
                buffers=packed_frame.buffers,
                picture=faults[0],
                camera=faults[1],
                camera_translation=translation,
                camera_quaternion=quaternion,
            )
        self._last = header
        bus.put_pixels(self._keys.frame, header, packed_frame.payload)
        if epoch != self._announced:
            doubt = camera_doubted(camera_from_wire(packed_frame.intrinsics))
            bus.health.warn_while("matrix", doubt)
            if doubt is not None:
                bus.log.say(doubt)
        self._announce(header)
        for mount_ns, given in new_mounts:
            self._publish_camera(header, self._of_camera(given), mount_ns)
        bus.health.count(counted_as)
        bus.health.worked_on(started, header)

    def _announce(self, header: FrameHeader) -> None:
        """Publish which camera is open, for readers that take no frames: in a new epoch, and then once a
        second."""
        now = now_ns()
        if header.camera_epoch == self._announced and now < self._announce_ns:
            return
        self._announced, self._announce_ns = header.camera_epoch, now + SECOND
        self._publish_camera(header, self._mount if self._mount_inbox is None else None, None)

    def _new_mounts(self) -> list[tuple[int, Mount]]:
        """The poses of a moving camera, or of the part that it is fixed to, that were given since the last
        frame."""
        if self._mount_inbox is None:
            return []
        new = []
        while (message := self._bus.take(self._mount_inbox, MountMessage)) is not None:
            new.append((message.capture_ns, message.mount))
            self._remember(message.capture_ns, message.mount)
        late = now_ns() - self._newest_mount_ns > _LATE_NS
        self._bus.health.warn_while("mount", _NO_MOUNT if late else None)
        return new

    def _remember(self, mount_ns: int, mount: Mount) -> None:
        """Keep a given pose. A time far before the last one is from another clock or program: then the
        earlier poses are dropped."""
        if self._mounts and mount_ns < self._mounts[-1][0] - _BACK_NS:
            self._mounts.clear()
        if not self._mounts or mount_ns > self._mounts[-1][0]:
            self._mounts.append((mount_ns, mount))
            self._newest_mount_ns = mount_ns

    def _camera_pose(
        self, packed_frame: Packed, capture_ns: int
    ) -> tuple[Vector3, Quaternion] | tuple[None, None]:
        """The camera pose at the capture: from the poses that were given, or from the source if none
        was."""
        if not self._mounts:
            return optional_pose_to_wire(packed_frame.T_parent_cam)
        given = mount_at(self._mounts, capture_ns)
        if given is None:
            return None, None
        mount = self._of_camera(given)
        return mount.translation, mount.quaternion

    def _of_camera(self, given: Mount) -> Mount:
        """The pose of the camera, from the given pose of the camera or of the part that it is fixed to."""
        return given if self._mount is None else composed(given, self._mount)

    def _publish_camera(self, header: FrameHeader, mount: Mount | None, mount_ns: int | None) -> None:
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
