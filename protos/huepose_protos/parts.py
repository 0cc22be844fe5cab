"""Parts of several messages (common fields, masks, arrays, cameras, clocks), and the messages about the
objects that the pipeline searches for and the tracker's hypotheses."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal

from msgspec import Meta, Struct
from msgspec.structs import force_setattr

from huepose_protos.fields import (
    VERSION,
    BoxXYWH,
    Count,
    Covariance,
    Epoch,
    Fraction,
    Index,
    Name,
    Positive,
    Quaternion,
    Size,
    Stamp,
    Text,
    Vector3,
    Version,
    check_box,
    check_covariance,
    check_finite,
    check_pose,
)

KIB = 1024


class Message(Struct, frozen=True, kw_only=True):
    """The fields of every message. More than `max_bytes` is refused before anything is decoded."""

    max_bytes: ClassVar[int] = 64 * KIB
    version: Version = VERSION
    publish_ns: Stamp


MAX_FRAME_PIXELS = 64 * 1024 * KIB // 5
"""A frame has at most 64 MiB, and five bytes a pixel for colour and depth."""


class MaskRuns(Struct, frozen=True, kw_only=True):
    """A mask of the size of its image as run lengths, row by row: outside the mask, inside, outside, ..."""

    width: Size
    height: Size
    runs: Annotated[list[Index], Meta(max_length=200_000)]

    def __post_init__(self) -> None:
        if self.width * self.height > MAX_FRAME_PIXELS:
            raise ValueError(f"a mask has more pixels than a frame may have, {MAX_FRAME_PIXELS}")
        if sum(self.runs) != self.width * self.height:
            raise ValueError("mask runs do not add up to width x height")


MAX_CANDIDATE_PIXELS = 2**28
"""Of all masks of a message: 8 candidates for each of 16 objects in an image of 1920 x 1080."""


def check_masks(masks: Iterable[MaskRuns]) -> None:
    """Raise ValueError if the masks of a message would take too much memory: a few bytes of run lengths can
    describe very large masks."""
    if sum(mask.width * mask.height for mask in masks) > MAX_CANDIDATE_PIXELS:
        raise ValueError(f"the masks have more than {MAX_CANDIDATE_PIXELS} pixels together")


class BufferSpec(Struct, frozen=True, kw_only=True):
    """One array of the payload, row by row, little-endian, at a byte offset."""

    name: Annotated[str, Meta(pattern=r"^[a-z_]{1,32}\Z")]
    dtype: Literal["uint8", "uint16", "int32", "float32"]
    shape: Annotated[list[Annotated[int, Meta(ge=0, le=2**24)]], Meta(min_length=1, max_length=4)]
    offset: Count


class Intrinsics(Struct, frozen=True, kw_only=True):
    """A pinhole camera in pixels; an integer coordinate is the centre of a pixel. Images are rectified."""

    fx: Positive
    fy: Positive
    cx: float
    cy: float
    width: Size
    height: Size
    depth_scale_m: Annotated[float, Meta(gt=0.0, le=1.0)]
    distortion_model: Literal["none"] = "none"
    distortion: Annotated[list[float], Meta(max_length=0)] = []

    def __post_init__(self) -> None:
        check_finite(fx=self.fx, fy=self.fy, cx=self.cx, cy=self.cy, depth_scale_m=self.depth_scale_m)


_ROUNDED = 0.02
"""How far the length of a quaternion may be from 1 if a person wrote it with few digits."""


class Mount(Struct, frozen=True, kw_only=True):
    """A camera's extrinsics: the pose of its optical frame in the frame `parent` of a robot or a room. A
    quaternion of nearly unit length, as people write it, is normalised."""

    parent: Annotated[str, Meta(min_length=1, max_length=64)]
    translation: Vector3
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        length = math.hypot(*self.quaternion)
        if 1e-6 < abs(length - 1.0) <= _ROUNDED:
            x, y, z, w = (value / length for value in self.quaternion)
            force_setattr(self, "quaternion", (x, y, z, w))
        check_pose(self.translation, self.quaternion)


class Clock(Struct, frozen=True, kw_only=True):
    """The machine whose monotonic clock gave the timestamps; add realtime_offset_ns to get Unix time."""

    clock_id: Annotated[str, Meta(min_length=1, max_length=64)]
    realtime_offset_ns: Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]


class Prior(Struct, frozen=True, kw_only=True):
    """A tracked pose and its timestamp; perception predicts it to the time of its frame.

    Velocity: linear of the object's origin in m/s, angular in rad/s, along the camera's axes."""

    stamp_ns: Stamp
    translation: Vector3
    quaternion: Quaternion
    velocity_linear: Vector3 | None = None
    velocity_angular: Vector3 | None = None
    covariance: Covariance | None = None

    def __post_init__(self) -> None:
        check_pose(self.translation, self.quaternion)
        check_finite(velocity_linear=self.velocity_linear, velocity_angular=self.velocity_angular)
        check_covariance(self.covariance)


class TruthObject(Struct, frozen=True, kw_only=True):
    """The ground truth of an object, null where the source does not know it. `visib_fract`: visible share,
    0..1."""

    object: Name | None
    object_id: Index | None
    instance: Index
    translation: Vector3 | None
    quaternion: Quaternion | None
    visib_fract: Fraction | None
    box: BoxXYWH | None

    def __post_init__(self) -> None:
        check_pose(self.translation, self.quaternion)
        check_box(self.box)


class ObjectEntry(Struct, frozen=True, kw_only=True):
    """An object that the pipeline searches for; `searching`: how many of its instances were never seen yet.

    `added`: the number of its addition to the running list, 0 if it was there from the beginning; `resets`:
    how often it was reset; `retired`: [camera epoch, number]: instances of that epoch below that number ended
    by a reset, null if there are none; `box`: the box given at the last reset or addition, null without one;
    `reason`: why it is not seen, as far as camera and perception know, empty if all instances are seen."""

    object: Name
    max_instances: Annotated[int, Meta(ge=1, le=64)]
    searching: Count
    added: Count = 0
    resets: Count = 0
    retired: tuple[Epoch, Index] | None = None
    box: BoxXYWH | None = None
    reason: Text = ""

    def __post_init__(self) -> None:
        check_box(self.box)


class ObjectChange(Struct, frozen=True, kw_only=True):
    """A change of the tracker's list of objects."""

    action: Literal["add", "remove", "reset"]
    entry: ObjectEntry


class StageMark(Struct, frozen=True, kw_only=True):
    """A checksum of the tracker's state after a stage of a step."""

    stage: Annotated[str, Meta(max_length=32)]
    checksum: Annotated[int, Meta(ge=0, lt=2**32)]


MOST_OBJECTS = 256
"""Most objects that a pipeline searches for."""


class ObjectsMessage(Message, frozen=True, kw_only=True):
    """The objects that the pipeline searches for, once a second and when the list changes."""

    objects: Annotated[list[ObjectEntry], Meta(max_length=MOST_OBJECTS)]


class ControlRequest(Message, frozen=True, kw_only=True):
    """A query on `control`, from the pipeline's own machine: list or change the objects that it searches for.

    `list` names no object. `add` searches for one (up to max_instances of it), `remove` no longer does,
    `reset` forgets its poses and searches again; `box`: its box in the image, a hint for the detector."""

    action: Literal["list", "add", "remove", "reset"]
    object: Name | None = None
    max_instances: Annotated[int, Meta(ge=1, le=64)] = 1
    box: BoxXYWH | None = None

    def __post_init__(self) -> None:
        check_box(self.box)
        if (self.object is None) != (self.action == "list"):
            raise ValueError(f"{self.action} and object do not go together")


class ControlReply(Message, frozen=True, kw_only=True):
    """The answer: whether it was done, what was done or why not, and the list of objects as it is now."""

    done: bool
    text: Text
    objects: Annotated[list[ObjectEntry], Meta(max_length=MOST_OBJECTS)]


class HeldHypothesis(Struct, frozen=True, kw_only=True):
    """A hypothesis for the pose of an instance. share: its probability, with the sum 1 for an instance;
    source: what proposed it."""

    translation: Vector3
    quaternion: Quaternion
    share: Fraction
    source: Annotated[str, Meta(max_length=32)]

    def __post_init__(self) -> None:
        check_pose(self.translation, self.quaternion)


class HeldObject(Struct, frozen=True, kw_only=True):
    """One instance and its hypotheses, best first; the first is the published pose."""

    object: Name
    instance: Index
    hypotheses: Annotated[list[HeldHypothesis], Meta(max_length=8)]


class HypothesesMessage(Message, frozen=True, kw_only=True):
    """All hypotheses of the tracker in one frame, for display."""

    camera_epoch: Epoch
    frame_id: Count
    capture_ns: Stamp
    objects: Annotated[list[HeldObject], Meta(max_length=256)]
