"""One example of every message, with known numbers: the source of the golden vectors."""

from __future__ import annotations

import numpy as np

from huepose_protos.buffers import Array, pack
from huepose_protos.messages import (
    AgainRequest,
    CameraMessage,
    Clock,
    ControlReply,
    ControlRequest,
    CorrectionMessage,
    DetectedObject,
    Detections,
    EstimatedObject,
    Estimates,
    FrameHeader,
    HealthMessage,
    IntakeMessage,
    Intrinsics,
    Look,
    MaskedObject,
    MaskRuns,
    Masks,
    MemoryMessage,
    Message,
    Mount,
    MountMessage,
    ObjectChange,
    ObjectEntry,
    ObjectsMessage,
    PerceptionRequest,
    PoseMessage,
    Prior,
    RequestedObject,
    StageMark,
    TruthMessage,
    TruthObject,
)

_CAPTURE, _PUBLISH, _EPOCH = 1_000_000_000, 1_012_000_000, 7_346_501_928
_CLOCK = Clock(clock_id="5f0c3a52-0b0a-4d3e-9c50-1c9f5f2d8a11", realtime_offset_ns=1_763_000_000_000_000_000)
_TRANSLATION = (0.125, -0.0625, 0.75)
_QUATERNION = (0.0, 0.6, 0.0, 0.8)
_COVARIANCE = [1e-6 if i % 7 == 0 else 0.0 for i in range(36)]


def images() -> dict[str, Array]:
    """The buffers of the example frame: color (2, 4, 3), depth (2, 4)."""
    color = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    depth = (np.arange(8, dtype=np.uint16) * 1000).reshape(2, 4)
    return {"color": color, "depth": depth}


def messages() -> list[Message]:
    """One of each kind."""
    specs, _ = pack(images())
    mount = Mount(parent="base_link", translation=_TRANSLATION, quaternion=_QUATERNION)
    frame = FrameHeader(
        publish_ns=_PUBLISH,
        camera_epoch=_EPOCH,
        frame_id=42,
        capture_ns=_CAPTURE,
        clock=_CLOCK,
        frame="cam0_color_optical",
        intrinsics=Intrinsics(fx=500.0, fy=501.5, cx=1.5, cy=0.5, width=4, height=2, depth_scale_m=0.0001),
        buffers=specs,
    )
    prior = Prior(
        stamp_ns=_CAPTURE,
        translation=_TRANSLATION,
        quaternion=_QUATERNION,
        velocity_linear=(0.1, 0.0, -0.25),
        velocity_angular=(0.0, 1.5, 0.0),
        covariance=_COVARIANCE,
    )
    known = RequestedObject(object="006_mustard_bottle", instance=3, prior=prior)
    anywhere = RequestedObject(object="003_cracker_box", instance=None, wanted=2)
    detected = DetectedObject(request=known, box=(1.0, 0.0, 2.0, 2.0), score=0.875)
    mask = MaskRuns(width=4, height=2, runs=[1, 2, 2, 2, 1])
    correction = CorrectionMessage(
        publish_ns=_PUBLISH,
        object="006_mustard_bottle",
        instance=3,
        camera_epoch=_EPOCH,
        frame_id=42,
        capture_ns=_CAPTURE,
        translation=_TRANSLATION,
        quaternion=_QUATERNION,
        quality=0.96875,
        verdict="correct",
        seq=5,
        mask=mask,
    )
    request = PerceptionRequest(
        publish_ns=_PUBLISH,
        seq=17,
        camera_epoch=_EPOCH,
        deadline_ns=_PUBLISH + 600_000_000,
        objects=[known, anywhere],
    )
    return [
        frame,
        CameraMessage(
            publish_ns=_PUBLISH,
            camera_epoch=_EPOCH,
            clock=_CLOCK,
            frame="cam0_color_optical",
            intrinsics=frame.intrinsics,
        ),
        request,
        Look(publish_ns=_PUBLISH, request=request, frame=frame),
        Detections(publish_ns=_PUBLISH, request_seq=17, request_ns=_PUBLISH, frame=frame, objects=[detected]),
        Masks(
            publish_ns=_PUBLISH,
            request_seq=17,
            request_ns=_PUBLISH,
            frame=frame,
            objects=[MaskedObject(detection=detected, masks=[mask])],
        ),
        Estimates(
            publish_ns=_PUBLISH,
            request_seq=17,
            camera_epoch=_EPOCH,
            frame_id=42,
            capture_ns=_CAPTURE,
            estimates=[
                EstimatedObject(
                    object="006_mustard_bottle",
                    instance=3,
                    found=True,
                    state="TRACKING",
                    quality=0.96875,
                    score=0.8125,
                    margin=0.25,
                    translation=_TRANSLATION,
                    quaternion=_QUATERNION,
                    covariance=_COVARIANCE,
                    prior_score=0.75,
                    prior_translation=_TRANSLATION,
                    prior_quaternion=_QUATERNION,
                    box=(1.0, 0.0, 2.0, 2.0),
                    mask=mask,
                    seconds=0.0625,
                ),
                EstimatedObject(
                    object="003_cracker_box",
                    instance=None,
                    found=False,
                    state="LOST",
                    quality=0.0,
                    score=0.0,
                    margin=0.0,
                    reason="No view of the object resembles what is in the box.",
                ),
            ],
        ),
        correction,
        PoseMessage(
            publish_ns=_PUBLISH,
            object="006_mustard_bottle",
            instance=3,
            camera_epoch=_EPOCH,
            frame_id=42,
            capture_ns=_CAPTURE,
            frame="cam0_color_optical",
            clock_id=_CLOCK.clock_id,
            realtime_offset_ns=_CLOCK.realtime_offset_ns,
            state="TRACKING",
            quality=0.96875,
            translation=_TRANSLATION,
            quaternion=_QUATERNION,
            velocity_linear=(0.1, 0.0, -0.25),
            velocity_angular=(0.0, 1.5, 0.0),
            covariance=_COVARIANCE,
            applied_correction_seq=5,
        ),
        ObjectsMessage(
            publish_ns=_PUBLISH,
            objects=[
                ObjectEntry(object="006_mustard_bottle", max_instances=1, searching=0),
                ObjectEntry(
                    object="003_cracker_box",
                    max_instances=2,
                    searching=1,
                    resets=3,
                    retired=(_EPOCH, 4),
                    box=(1.0, 0.0, 2.0, 2.0),
                    reason="No place in the picture looks like the object.",
                ),
            ],
        ),
        ControlRequest(
            publish_ns=_PUBLISH,
            action="reset",
            object="003_cracker_box",
            max_instances=2,
            box=(1.0, 0.0, 2.0, 2.0),
        ),
        ControlReply(
            publish_ns=_PUBLISH,
            done=False,
            text="003_cracker_box is not looked for",
            objects=[ObjectEntry(object="006_mustard_bottle", max_instances=1, searching=0)],
        ),
        MountMessage(publish_ns=_PUBLISH, capture_ns=_CAPTURE, mount=mount),
        HealthMessage(
            publish_ns=_PUBLISH,
            worker="tracker",
            pid=4242,
            state="ready",
            clock=_CLOCK,
            uptime_s=12.5,
            rate_hz=30.0,
            cpu_percent=62.5,
            memory_mib=180.0,
            camera_epoch=_EPOCH,
            frame_id=42,
            work_ms=(12.0, 21.0),
            age_ms=(15.0, 33.0),
            shared_memory=True,
            counters={"frames": 360, "wire_errors": 1},
            warnings=[],
            locked_mib=7.25,
            drops=2,
            errors=1,
            last_error="dropped a message on huepose/local/cam0/frame: foreign version 2.0, this is 1.x",
        ),
        TruthMessage(
            publish_ns=_PUBLISH,
            camera_epoch=_EPOCH,
            frame_id=42,
            capture_ns=_CAPTURE,
            scene="synthetic",
            image=42,
            objects=[
                TruthObject(
                    object="006_mustard_bottle",
                    object_id=5,
                    instance=0,
                    translation=_TRANSLATION,
                    quaternion=_QUATERNION,
                    visib_fract=0.75,
                    box=(1.0, 0.0, 2.0, 2.0),
                )
            ],
        ),
        IntakeMessage(
            publish_ns=_PUBLISH,
            seq=360,
            clock_ns=[_CAPTURE, _PUBLISH],
            changes=[
                ObjectChange(
                    action="add",
                    entry=ObjectEntry(object="003_cracker_box", max_instances=2, searching=2),
                )
            ],
            corrections=[correction],
            camera_epoch=_EPOCH,
            frame_id=42,
            marks=[StageMark(stage="follow", checksum=3_735_928_559)],
        ),
        MemoryMessage(
            publish_ns=_PUBLISH,
            seq=360,
            config='{"site":"local"}',
            objects=["006_mustard_bottle"],
            memory=b"\x80",
            frames=[(_EPOCH, 42)],
        ),
        AgainRequest(publish_ns=_PUBLISH, frames=[(_EPOCH, 42)], steps=[359]),
    ]
