"""Messages with pixels (the payload is the buffers back to back, the header is its attachment), and masks as
run lengths."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from huepose_protos.fields import WireError
from huepose_protos.messages import BufferSpec, FrameHeader, MaskRuns

MAX_PAYLOAD = 64 * 1024 * 1024
Array = NDArray[Any]


def pack(arrays: Mapping[str, Array]) -> tuple[list[BufferSpec], bytes]:
    """Specs and payload of named arrays (uint8, uint16, int32 or float32), in their order."""
    specs: list[BufferSpec] = []
    parts: list[memoryview] = []
    offset = 0
    for name, array in arrays.items():
        little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        kind = cast(Any, array.dtype.name)  # BufferSpec lists the types.
        specs.append(BufferSpec(name=name, dtype=kind, shape=list(array.shape), offset=offset))
        parts.append(little.data)
        offset += little.nbytes
    if offset > MAX_PAYLOAD:
        raise WireError(f"payload of {offset} bytes is over {MAX_PAYLOAD}")
    return specs, b"".join(parts)


def unpack(specs: Sequence[BufferSpec], payload: bytes) -> dict[str, Array]:
    """Read-only arrays on a payload. Raises WireError unless they fill it exactly, back to back."""
    if len(payload) > MAX_PAYLOAD:
        raise WireError(f"payload of {len(payload)} bytes is over {MAX_PAYLOAD}")
    arrays: dict[str, Array] = {}
    at = 0
    for spec in specs:
        dtype = np.dtype(spec.dtype).newbyteorder("<")
        size = math.prod(spec.shape) * dtype.itemsize
        if spec.offset != at or at + size > len(payload) or spec.name in arrays:
            raise WireError(f"buffer {spec.name}: offset {spec.offset} and {size} bytes do not fit")
        flat = np.frombuffer(payload, dtype, math.prod(spec.shape), at)
        try:
            arrays[spec.name] = flat.reshape(spec.shape)
        except ValueError as error:  # no elements, but sides that are too long
            raise WireError(f"buffer {spec.name}: {error}") from None
        at += size
    if at != len(payload):
        raise WireError(f"payload of {len(payload)} bytes, the buffers describe {at}")
    return arrays


def frame_images(header: FrameHeader, payload: bytes) -> tuple[Array, Array]:
    """color (H, W, 3) uint8 and depth (H, W) uint16 of a frame. Raises WireError if they do not fit."""
    arrays = unpack(header.buffers, payload)
    size = (header.intrinsics.height, header.intrinsics.width)
    for name, shape, dtype in (("color", (*size, 3), "uint8"), ("depth", size, "uint16")):
        if name not in arrays:
            raise WireError(f"frame without the buffer {name}")
        if arrays[name].shape != shape or arrays[name].dtype.name != dtype:
            raise WireError(f"{name} is {arrays[name].shape} {arrays[name].dtype}, not {shape} {dtype}")
    return arrays["color"], arrays["depth"]


def runs_of(mask: NDArray[np.bool_]) -> MaskRuns:
    """Run lengths of a mask (H, W), row by row: outside (may be 0), inside, outside, ...

    >>> runs_of(np.array([[True, False], [True, True]])).runs
    [0, 1, 1, 2]
    """
    flat = np.ravel(mask)
    last = np.flatnonzero(flat[1:] != flat[:-1])  # last pixel of each run but the last one
    runs = np.diff(last, prepend=-1, append=flat.size - 1).tolist()
    return MaskRuns(width=mask.shape[1], height=mask.shape[0], runs=[0, *runs] if flat[0] else runs)


def mask_of(mask: MaskRuns, image_size: tuple[int, int] | None = None) -> NDArray[np.bool_]:
    """Mask (H, W) of run lengths; MaskRuns has checked their sum. image_size: height and width that it must
    have. Raises WireError for another size, before memory is allocated."""
    if image_size not in (None, (mask.height, mask.width)):
        raise WireError(f"a mask of {mask.width} x {mask.height} pixels has not the size of its frame")
    inside = np.arange(len(mask.runs)) % 2 == 1
    return np.repeat(inside, mask.runs).reshape(mask.height, mask.width)
