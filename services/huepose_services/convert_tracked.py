"""Between the wire and the tracker: corrections in, tracked poses out."""

from __future__ import annotations

from huepose.tracking.types import Correction, TrackedPose, Verdict
from huepose_protos.messages import CorrectionMessage, FrameHeader, PoseMessage
from huepose_protos.runlength import mask_of
from huepose_services.convert import (
    covariance_to_wire,
    optional_pose_to_wire,
    pose_from_wire,
    twist_to_wire,
)


def correction_from_wire(message: CorrectionMessage, header: FrameHeader | None = None) -> Correction:
    """The correction of a message. header: of a frame of the camera that it is about; raises WireError for a
    mask that has not that frame's size."""
    size = None if header is None else (header.intrinsics.height, header.intrinsics.width)
    return Correction(
        object=message.object,
        instance=message.instance,
        epoch=message.camera_epoch,
        frame_id=message.frame_id,
        stamp_ns=message.capture_ns,
        T_cam_obj=pose_from_wire(message.translation, message.quaternion),
        quality=message.quality,
        verdict=Verdict(message.verdict),
        seq=message.seq,
        mask=None if message.mask is None else mask_of(message.mask, size),
    )


def tracked_to_wire(pose: TrackedPose, header: FrameHeader, publish_ns: int, reason: str = "") -> PoseMessage:
    """The message of a tracked pose; the header names the camera's frame and clock."""
    translation, quaternion = optional_pose_to_wire(pose.T_cam_obj)
    linear, angular = twist_to_wire(pose.velocity)
    return PoseMessage(
        publish_ns=publish_ns,
        object=pose.object,
        instance=pose.instance,
        camera_epoch=pose.epoch,
        frame_id=pose.frame_id,
        capture_ns=pose.stamp_ns,
        frame=header.frame,
        clock_id=header.clock.clock_id,
        realtime_offset_ns=header.clock.realtime_offset_ns,
        state=pose.state.value,
        quality=pose.quality,
        translation=translation,
        quaternion=quaternion,
        velocity_linear=linear,
        velocity_angular=angular,
        covariance=covariance_to_wire(pose.covariance),
        applied_correction_seq=pose.applied_correction_seq,
        reason=reason,
    )
