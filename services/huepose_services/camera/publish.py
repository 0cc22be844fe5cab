"""Puts pictures on the bus as frames, and says once a second what the camera is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from huepose.datasets.types import GroundTruth
from huepose.geometry import RgbdFrame
from huepose_protos.buffers import pack
from huepose_protos.messages import (
    BufferSpec,
    CameraMessage,
    FrameHeader,
    Intrinsics,
    TruthMessage,
    TruthObject,
)
from huepose_services.convert import box_to_wire, depth_to_wire, intrinsics_to_wire, optional_pose_to_wire
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns, this_clock
from huepose_services.runtime.config import Config


@dataclass(frozen=True)
class Packed:
    """A picture that is ready to go."""

    intrinsics: Intrinsics
    buffers: list[BufferSpec]
    payload: bytes


def packed(frame: RgbdFrame, depth_scale_m: float) -> Packed:
    """Colour and depth as they travel, depth in steps of depth_scale_m."""
    depth = depth_to_wire(frame.depth, depth_scale_m)
    buffers, payload = pack({"color": frame.color, "depth": depth})
    return Packed(intrinsics_to_wire(frame.camera, depth_scale_m), buffers, payload)


class FramePublisher:
    """The camera's side of the bus."""

    def __init__(self, bus: Bus, config: Config) -> None:
        self._bus, self._keys = bus, config.keys
        self._frame_name = f"{config.camera.name}_color_optical"
        self._mount = config.camera.mount
        self._told: int | None = None
        self._tell_ns = 0

    def publish(
        self, picture: Packed, epoch: int, frame_id: int, capture_ns: int, counted_as: str = "frames"
    ) -> None:
        """One frame, counted and timed in health."""
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
        )
        bus.put_pixels(self._keys.frame, header, picture.payload)
        self._tell(header)
        bus.health.camera_epoch, bus.health.frame_id = epoch, frame_id
        bus.health.count(counted_as)
        bus.health.worked(started, capture_ns)

    def publish_truth(
        self,
        truths: Sequence[GroundTruth],
        epoch: int,
        frame_id: int,
        capture_ns: int,
        scene: str,
        image: int,
    ) -> None:
        """What the source knows about a frame; said before the frame itself."""
        objects = []
        for truth in truths:
            translation, quaternion = optional_pose_to_wire(truth.T_cam_obj)
            objects.append(
                TruthObject(
                    object=truth.object,
                    object_id=truth.object_id,
                    instance=truth.instance,
                    translation=translation,
                    quaternion=quaternion,
                    visib_fract=truth.visib_fract,
                    box=None if truth.box_visib is None else box_to_wire(truth.box_visib),
                )
            )
        message = TruthMessage(
            publish_ns=now_ns(),
            camera_epoch=epoch,
            frame_id=frame_id,
            capture_ns=capture_ns,
            scene=scene,
            image=image,
            objects=objects,
        )
        self._bus.put(self._keys.truth, message)

    def _tell(self, header: FrameHeader) -> None:
        """Which camera is open, for readers that take no frames: when it is new, and then once a second."""
        now = now_ns()
        if header.camera_epoch == self._told and now < self._tell_ns:
            return
        self._told, self._tell_ns = header.camera_epoch, now + SECOND
        message = CameraMessage(
            publish_ns=now,
            camera_epoch=header.camera_epoch,
            clock=header.clock,
            frame=header.frame,
            intrinsics=header.intrinsics,
            mount=self._mount,
        )
        self._bus.put(self._keys.camera_info, message)
