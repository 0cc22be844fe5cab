"""What several messages are made of: what all of them have, masks, arrays, cameras, clocks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal

from msgspec import Meta, Struct

from huepose_protos.fields import (
    VERSION,
    Count,
    Index,
    Positive,
    Quaternion,
    Size,
    Stamp,
    Vector3,
    Version,
    check_finite,
    check_pose,
)

KIB = 1024


class Message(Struct, frozen=True, kw_only=True):
    """What every message on a key has. More than `max_bytes` is refused before anything is decoded."""

    max_bytes: ClassVar[int] = 64 * KIB
    version: Version = VERSION
    publish_ns: Stamp


MAX_FRAME_PIXELS = 64 * 1024 * KIB // 5
"""A pixel of a frame takes five bytes, colour and depth, of at most 64 MiB."""


class MaskRuns(Struct, frozen=True, kw_only=True):
    """A mask of the size of its image: runs of pixels row by row, the first of them outside, then in turn."""

    width: Size
    height: Size
    runs: Annotated[list[Index], Meta(max_length=200_000)]

    def __post_init__(self) -> None:
        if self.width * self.height > MAX_FRAME_PIXELS:
            raise ValueError(f"a mask has more pixels than a frame may have, {MAX_FRAME_PIXELS}")
        if sum(self.runs) != self.width * self.height:
            raise ValueError("mask runs do not add up to width x height")


def check_masks(masks: Iterable[MaskRuns | None], most_pixels: int) -> None:
    """Raise ValueError for masks that would take more memory than that: a few bytes can stand for much."""
    if sum(mask.width * mask.height for mask in masks if mask is not None) > most_pixels:
        raise ValueError(f"the masks have more than {most_pixels} pixels together")


class BufferSpec(Struct, frozen=True, kw_only=True):
    """One array of the payload, row by row, little-endian, at a byte offset."""

    name: Annotated[str, Meta(pattern=r"^[a-z_]{1,32}$")]
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


class Mount(Struct, frozen=True, kw_only=True):
    """Where a camera is fixed: the pose of its optical frame in the frame `parent` of a robot or a room."""

    parent: Annotated[str, Meta(min_length=1, max_length=64)]
    translation: Vector3
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        check_pose(self.translation, self.quaternion)


class Clock(Struct, frozen=True, kw_only=True):
    """Which machine's monotonic clock the stamps are of; add realtime_offset_ns to get Unix time."""

    clock_id: Annotated[str, Meta(min_length=1, max_length=64)]
    realtime_offset_ns: Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
