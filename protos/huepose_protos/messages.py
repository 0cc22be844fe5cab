"""The messages. The types are the schema. What a type cannot express is checked when a message is made, so
by the sender and by the receiver. Subscribers ignore unknown fields; within a major version fields are only
added, with defaults.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Meta, Struct, field

from huepose_protos.fields import (
    BoxXYWH,
    Count,
    Covariance,
    Epoch,
    Fraction,
    HealthState,
    Index,
    Name,
    Quaternion,
    Stamp,
    StateName,
    Text,
    Vector3,
    VerdictName,
    check_box,
    check_covariance,
    check_finite,
    check_pose,
)
from huepose_protos.parts import KIB, check_masks
from huepose_protos.parts import MOST_OBJECTS as MOST_OBJECTS
from huepose_protos.parts import BufferSpec as BufferSpec
from huepose_protos.parts import Clock as Clock
from huepose_protos.parts import ControlReply as ControlReply
from huepose_protos.parts import ControlRequest as ControlRequest
from huepose_protos.parts import HeldHypothesis as HeldHypothesis
from huepose_protos.parts import HeldObject as HeldObject
from huepose_protos.parts import HypothesesMessage as HypothesesMessage
from huepose_protos.parts import Intrinsics as Intrinsics
from huepose_protos.parts import MaskRuns as MaskRuns
from huepose_protos.parts import Message as Message
from huepose_protos.parts import Mount as Mount
from huepose_protos.parts import ObjectChange as ObjectChange
from huepose_protos.parts import ObjectEntry as ObjectEntry
from huepose_protos.parts import ObjectsMessage as ObjectsMessage
from huepose_protos.parts import Prior as Prior
from huepose_protos.parts import StageMark as StageMark
from huepose_protos.parts import TruthObject as TruthObject


class FrameHeader(Message, frozen=True, kw_only=True):
    """Attachment of a frame. Buffers `color` (H, W, 3) uint8 RGB and `depth` (H, W) uint16: times
    depth_scale_m metres, 0 for no reading, in the pixels of the colour image. `picture`: a fault of this
    image because of which nothing can be found in it; `camera`: a fault of all images, and so of every
    pose; both empty without a fault. `camera_translation`, `camera_quaternion`: the pose of a moving camera
    when it took the image, in a frame that does not move; null if it was not known in time."""

    camera_epoch: Epoch
    frame_id: Count
    capture_ns: Stamp
    clock: Clock
    frame: Annotated[str, Meta(max_length=64, description="name of the camera's coordinate frame")]
    intrinsics: Intrinsics
    buffers: Annotated[list[BufferSpec], Meta(max_length=8)]
    picture: Text = ""
    camera: Text = ""
    camera_translation: Vector3 | None = None
    camera_quaternion: Quaternion | None = None

    def __post_init__(self) -> None:
        check_pose(self.camera_translation, self.camera_quaternion)


class CameraMessage(Message, frozen=True, kw_only=True):
    """The open camera, for subscribers without frames: sent once a second, and for a moving camera with each
    new pose of it. `mount`: the camera's extrinsics, null if not known; `mount_ns`: the time of this mount if
    the camera moves, null if it is fixed."""

    camera_epoch: Epoch
    clock: Clock
    frame: Annotated[str, Meta(max_length=64, description="name of the camera's coordinate frame")]
    intrinsics: Intrinsics
    mount: Mount | None = None
    mount_ns: Stamp | None = None


class MountMessage(Message, frozen=True, kw_only=True):
    """The pose of a moving camera, or of the part of the robot that it is fixed to, at a time of this
    machine's CLOCK_MONOTONIC. A program of the robot sends it to the camera."""

    capture_ns: Stamp
    mount: Mount


class RequestedObject(Struct, frozen=True, kw_only=True):
    """An object to look at: a tracked instance (with its prior) or, with instance null, up to `wanted` new
    instances anywhere in the image. `known`: the instance is TRACKING; if false, it is checked whether it is
    the object at all. `others`: the object's TRACKING instances; a new one is not searched for on them."""

    object: Name
    instance: Index | None
    prior: Prior | None = None
    wanted: Annotated[int, Meta(ge=1, le=64)] = 1
    known: bool = False
    others: Annotated[list[Prior], Meta(max_length=64)] = []


class PerceptionRequest(Message, frozen=True, kw_only=True):
    """Which objects to look at in the newest frame. `seq` grows with each request; camera_epoch is that of
    the newest tracked frame, null before the first. An answer after deadline_ns is not waited for. `seen`:
    epoch and number of a frame for which all of this was answered; while it is the newest, perception waits
    for the next. `waiting`: other missing objects, which are also searched for if something new looks like
    them."""

    max_bytes: ClassVar[int] = 1024 * KIB
    seq: Count
    camera_epoch: Epoch | None
    deadline_ns: Stamp
    objects: Annotated[list[RequestedObject], Meta(max_length=64)]
    seen: tuple[Epoch, Count] | None = None
    waiting: Annotated[list[RequestedObject], Meta(max_length=256)] = field(default_factory=list)


class Look(Message, frozen=True, kw_only=True):
    """A request with its frame, for a detector on another computer; the payload is the frame's."""

    max_bytes: ClassVar[int] = 1024 * KIB
    request: PerceptionRequest
    frame: FrameHeader


MOST_BOXES = 64
"""The most boxes in Detections, and so the most objects in Masks and Estimates."""


class DetectedObject(Struct, frozen=True, kw_only=True):
    """A requested object and the box to search for it in."""

    request: RequestedObject
    box: BoxXYWH
    score: Fraction

    def __post_init__(self) -> None:
        check_box(self.box)


class Detections(Message, frozen=True, kw_only=True):
    """Boxes in one frame; the payload is the frame's. `request_ns`: when the request was published;
    `camera`: evidence in the image against this camera's settings, empty if there is none."""

    max_bytes: ClassVar[int] = 1024 * KIB
    request_seq: Count
    request_ns: Stamp
    frame: FrameHeader
    objects: Annotated[list[DetectedObject], Meta(max_length=MOST_BOXES)]
    camera: Text = ""


class MaskedObject(Struct, frozen=True, kw_only=True):
    """A detected object and its candidate masks, most likely first; none if nothing was segmented."""

    detection: DetectedObject
    masks: Annotated[list[MaskRuns], Meta(max_length=8)]


class Masks(Message, frozen=True, kw_only=True):
    """Masks in one frame; the payload is the frame's. `camera`: as in Detections."""

    max_bytes: ClassVar[int] = 1024 * KIB
    request_seq: Count
    request_ns: Stamp
    frame: FrameHeader
    objects: Annotated[list[MaskedObject], Meta(max_length=MOST_BOXES)]
    camera: Text = ""

    def __post_init__(self) -> None:
        check_masks(mask for item in self.objects for mask in item.masks)


class EstimatedObject(Struct, frozen=True, kw_only=True):
    """The estimator's answer for one requested object; instance as requested.

    score: of the pose; prior_score: of the refined prior on the same pixels, which is prior_translation and
    prior_quaternion. quality: the probability that the pose is right; present: the probability that the
    object is there at all, null if not asked. reason: why nothing was found, or why the pose must not be
    acted on; else empty."""

    object: Name
    instance: Index | None
    found: bool
    state: StateName
    quality: Fraction
    score: float
    margin: float
    translation: Vector3 | None = None
    quaternion: Quaternion | None = None
    covariance: Covariance | None = None
    prior_score: float | None = None
    prior_translation: Vector3 | None = None
    prior_quaternion: Quaternion | None = None
    box: BoxXYWH | None = None
    seconds: Annotated[float, Meta(ge=0.0)] = 0.0
    reason: Text = ""
    present: Fraction | None = None

    def __post_init__(self) -> None:
        check_pose(self.translation, self.quaternion)
        check_pose(self.prior_translation, self.prior_quaternion, "prior_")
        if self.found != (self.translation is not None):
            raise ValueError("found must say whether there is a pose")
        check_finite(score=self.score, margin=self.margin, prior_score=self.prior_score, seconds=self.seconds)
        check_covariance(self.covariance)
        check_box(self.box)


class Estimates(Message, frozen=True, kw_only=True):
    """Answers to one request, all computed on one frame. `picture`: a fault of that frame because of which
    nothing was found in it; `camera`: evidence in images and poses against this camera's settings, and so
    against every pose; both else empty."""

    max_bytes: ClassVar[int] = 1024 * KIB
    request_seq: Count
    camera_epoch: Epoch
    frame_id: Count
    capture_ns: Stamp
    estimates: Annotated[list[EstimatedObject], Meta(max_length=MOST_BOXES)]
    picture: Text = ""
    camera: Text = ""


class CorrectionMessage(Message, frozen=True, kw_only=True):
    """A verdict of the re-initialisation loop on one instance in one past frame. `seq`: the time at which it
    was made, ns; it grows for each instance. `camera`: as in Estimates, why no pose of this camera may be
    acted on; `reason`: of the estimate, why no pose of this instance may be; `present`: of the estimate."""

    object: Name
    instance: Index
    camera_epoch: Epoch
    frame_id: Count
    capture_ns: Stamp
    translation: Vector3
    quaternion: Quaternion
    quality: Fraction
    verdict: VerdictName
    seq: Count
    camera: Text = ""
    reason: Text = ""
    present: Fraction | None = None

    def __post_init__(self) -> None:
        check_pose(self.translation, self.quaternion)


class PoseMessage(Message, frozen=True, kw_only=True):
    """One object at one frame. Pose, velocity and covariance are null while SEARCHING or LOST.

    reason: a sentence for people, why it is not TRACKING, else empty; centre: the object's centre in its own
    frame; to predict, this point moves on a straight line while the object rotates about it."""

    max_bytes: ClassVar[int] = 4 * KIB
    object: Name
    instance: Index
    camera_epoch: Epoch
    frame_id: Count
    capture_ns: Stamp
    frame: Annotated[str, Meta(max_length=64)]
    clock_id: Annotated[str, Meta(min_length=1, max_length=64)]
    realtime_offset_ns: Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
    state: StateName
    quality: Fraction
    translation: Vector3 | None
    quaternion: Quaternion | None
    velocity_linear: Vector3 | None
    velocity_angular: Vector3 | None
    covariance: Covariance | None
    applied_correction_seq: Count
    reason: Text = ""
    centre: Vector3

    def __post_init__(self) -> None:
        check_pose(self.translation, self.quaternion)
        if (self.translation is None) != (self.state in ("SEARCHING", "LOST")):
            raise ValueError(f"a pose does not go with the state {self.state}")
        check_finite(
            velocity_linear=self.velocity_linear, velocity_angular=self.velocity_angular, centre=self.centre
        )
        check_covariance(self.covariance)

    @property
    def age_ms(self) -> float:
        """Milliseconds from the capture of its frame until it was published."""
        return (self.publish_ns - self.capture_ns) * 1e-6


class HealthMessage(Message, frozen=True, kw_only=True):
    """The state of a worker, once a second.

    rate_hz: of its work; frame_id: the last frame that it had, null before the first; work_ms and age_ms:
    median and 99th percentile over the last seconds of the time to process one message, and of the time from
    capture to the end of that; shared_memory: whether the last frame came through it, null before the first;
    locked_mib: locked memory, most of it shared memory for frames; drops: messages that arrived and were
    replaced by newer ones, or lost, before they were read; errors: number of exceptions and refused messages;
    last_error: the newest of them; counters only grow; restarts: how often the worker was restarted since its
    pipeline began; picture: for a camera, why nothing can be found in its images, or why no image comes, else
    empty."""

    worker: Name
    pid: Count
    state: HealthState
    clock: Clock
    uptime_s: Annotated[float, Meta(ge=0.0)]
    rate_hz: Annotated[float, Meta(ge=0.0)]
    cpu_percent: Annotated[float, Meta(ge=0.0)]
    memory_mib: Annotated[float, Meta(ge=0.0)]
    camera_epoch: Epoch | None
    frame_id: Count | None
    work_ms: tuple[float, float] | None
    age_ms: tuple[float, float] | None
    shared_memory: bool | None
    counters: dict[str, Count]
    warnings: Annotated[list[Text], Meta(max_length=32)]
    locked_mib: Annotated[float, Meta(ge=0.0)] = 0.0
    drops: Count = 0
    errors: Count = 0
    last_error: Text = ""
    restarts: Count = 0
    picture: Text = ""

    def __post_init__(self) -> None:
        check_finite(
            uptime_s=self.uptime_s,
            rate_hz=self.rate_hz,
            cpu_percent=self.cpu_percent,
            memory_mib=self.memory_mib,
            locked_mib=self.locked_mib,
            work_ms=self.work_ms,
            age_ms=self.age_ms,
        )


class TruthMessage(Message, frozen=True, kw_only=True):
    """Ground truth of one frame, for scores: no worker that finds or tracks objects reads it."""

    camera_epoch: Epoch
    frame_id: Count
    capture_ns: Stamp
    scene: Annotated[str, Meta(max_length=128)]
    image: Annotated[int, Meta(ge=0, description="number of the image in its data set")]
    objects: Annotated[list[TruthObject], Meta(max_length=256)]


class IntakeMessage(Message, frozen=True, kw_only=True):
    """All inputs of one step of the tracker, in this order: changes, corrections, a frame (null: none); and
    the times that it read. From these and the frame its poses can be computed again, bit by bit.

    `seq` counts the steps with an input since the tracker started."""

    max_bytes: ClassVar[int] = 4096 * KIB
    seq: Count
    clock_ns: Annotated[list[Stamp], Meta(max_length=16_384)]
    changes: list[ObjectChange]
    corrections: list[CorrectionMessage]
    camera_epoch: Epoch | None
    frame_id: Count | None
    marks: list[StageMark]


class MemoryMessage(Message, frozen=True, kw_only=True):
    """The whole state of the tracker after step `seq`, from which its poses can be computed again.

    `config`: the pipeline's configuration in JSON; `objects`: those that it knows; `memory`: MessagePack, for
    the same version of HuePose only; `frames`: those that it keeps, by camera epoch and number."""

    max_bytes: ClassVar[int] = 16 * 1024 * KIB
    seq: Count
    config: Annotated[str, Meta(max_length=1024 * KIB)]
    objects: list[Name]
    memory: bytes
    frames: Annotated[list[tuple[Epoch, Count]], Meta(max_length=4096)] = field(default_factory=list)


class AgainRequest(Message, frozen=True, kw_only=True):
    """Inputs of the tracker that a recorder has not received: frames (camera epoch, number), and steps."""

    frames: Annotated[list[tuple[Epoch, Count]], Meta(max_length=64)]
    steps: Annotated[list[Count], Meta(max_length=256)]


MESSAGES: tuple[type[Message], ...] = (
    FrameHeader,
    CameraMessage,
    MountMessage,
    PerceptionRequest,
    Look,
    Detections,
    Masks,
    Estimates,
    CorrectionMessage,
    PoseMessage,
    ObjectsMessage,
    ControlRequest,
    ControlReply,
    HealthMessage,
    TruthMessage,
    HypothesesMessage,
    IntakeMessage,
    MemoryMessage,
    AgainRequest,
)
