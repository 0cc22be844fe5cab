"""The whole state of a tracker as plain values, and back: another tracker continues from it, bit by bit the
same.

Frames are named, not copied: they are large, and the other tracker has them. Only the classes below are
created again, without calling any of their code, so a file with such values cannot run anything.
"""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from enum import Enum
from typing import Any

import numpy as np

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.judge.terms import Terms
from huepose.support.errors import InputError
from huepose.tracking.belief import Belief
from huepose.tracking.camera_place import CameraPlace
from huepose.tracking.catching_up import Pursuit
from huepose.tracking.config import TrackerConfig
from huepose.tracking.evidence import Identity, TrackState
from huepose.tracking.history import Entry, FrameHistory, PoseHistory, _Stretch
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.motion import Reach
from huepose.tracking.odometry import Keyframe, Odometry, Seen
from huepose.tracking.orientation import Facing, Orientation
from huepose.tracking.persistence import Persistence
from huepose.tracking.subject import Subject
from huepose.tracking.track import Track
from huepose.tracking.tracker import Tracker
from huepose.tracking.tries import Tries
from huepose.tracking.types import Correction, TrackedPose, Verdict
from huepose.tracking.usual import Usual

_CLASSES: dict[str, type] = {
    one.__name__: one
    for one in (
        *(
            Belief,
            Camera,
            CameraPlace,
            Correction,
            Entry,
            Facing,
            FrameHistory,
            Hypothesis,
            Identity,
            Keyframe,
        ),
        *(Odometry, Orientation, Persistence, PoseHistory, Pursuit, Reach, Seen, Terms, Track, TrackState),
        *(TrackedPose, Tries, Usual, _Stretch),
    )
}
_ENUMS: dict[str, type[Enum]] = {"State": State, "Verdict": Verdict}
_DTYPES = ("<f8", "<f4", "<i8", "<i4", "|u1", "|b1")
# What a tracker is created with, beside what it learns.
_GIVEN = ("config", "_subjects")

FrameOf = Callable[[int, int], RgbdFrame | None]


class _Frames:
    """The frames that a tracker stores, each with its camera pose (None: not known). Each is made once: a
    tracker compares frames by identity."""

    def __init__(self, frame_of: FrameOf) -> None:
        self._frame_of = frame_of
        self._made: dict[tuple[int, int], RgbdFrame] = {}

    def __call__(self, epoch: int, frame_id: int, T_parent_cam: Any) -> RgbdFrame:
        if (epoch, frame_id) not in self._made:
            frame = self._frame_of(epoch, frame_id)
            if frame is None:
                raise ValueError(f"frame {frame_id} of epoch {epoch} is missing")
            if T_parent_cam is not None:
                if not se3.is_rigid(T_parent_cam, se3.ROUNDED):
                    raise ValueError(f"the camera pose of frame {frame_id} is no rigid transform")
                frame = frame.seen_from(T_parent_cam)
            self._made[epoch, frame_id] = frame
        return self._made[epoch, frame_id]


def state_of(tracker: Tracker) -> dict[str, Any]:
    """The state of the tracker as plain values: None, numbers, text, bytes, lists, and dicts with text
    keys."""
    return {name: plain(value, tracker) for name, value in vars(tracker).items() if name not in _GIVEN}


def frames_of(memory: Any) -> Iterator[tuple[int, int]]:
    """(epoch, frame_id) of the frames that a state of `state_of` names."""
    if isinstance(memory, dict):
        if isinstance(memory.get("frame"), list):
            epoch, frame_id, _ = memory["frame"]
            yield epoch, frame_id
        memory = list(memory.values())
    if isinstance(memory, list):
        for one in memory:
            yield from frames_of(one)


def taken_over(tracker: Tracker, memory: Any, frame_of: FrameOf) -> None:
    """Give this state to a tracker of the same objects and settings. frame_of: from epoch and frame_id to the
    frame. Raises InputError for values that are no tracker's state, or name a frame that is missing."""
    learnt = [name for name in vars(tracker) if name not in _GIVEN]
    if not isinstance(memory, dict):
        memory = {}
    frames = _Frames(frame_of)
    vars(tracker).update({name: _checked(memory.get(name, {}), tracker, frames) for name in learnt})


def plain(value: Any, tracker: Tracker) -> Any:
    """The same for another value that consists of the same classes."""
    return _plain(value, {id(subject): name for name, subject in tracker._subjects.items()})


def restored(plain: Any, tracker: Tracker, frame_of: FrameOf) -> Any:
    """The value that `plain` was called with. Raises InputError for anything that `plain` did not return."""
    return _checked(plain, tracker, _Frames(frame_of))


def _checked(plain: Any, tracker: Tracker, frames: _Frames) -> Any:
    try:
        return _restored(plain, tracker, frames)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError) as error:
        raise InputError(
            "the tracker's memory",
            found=f"{type(error).__name__}: {error}"[:200],
            expected="the state of a tracker of this version",
        ) from None


def checksum(tracker: Tracker) -> int:
    """CRC-32 of all poses, with their log-odds, evidence and quality."""
    crc = 0
    tracks = [*tracker._tracks.values(), *(pursuit.track for pursuit in tracker._pursuits.values())]
    for track in tracks:
        for h in track.hypotheses:
            crc = zlib.crc32(np.append(h.T_cam_obj, h.log_odds).tobytes(), crc)
        crc = zlib.crc32(np.array((track.belief.evidence, track.belief.quality)).tobytes(), crc)
    return crc


def _plain(value: Any, names: dict[int, str]) -> Any:
    match value:
        case Enum():
            return {"enum": type(value).__name__, "value": value.value}
        case np.ndarray() | np.generic():
            array = np.asarray(value)
            columns = array.ndim > 1 and array.flags.f_contiguous and not array.flags.c_contiguous
            return {
                "array": array.tobytes("F" if columns else "C"),
                "dtype": array.dtype.str,
                "shape": list(array.shape),
                # The memory layout decides in which order numbers are added up.
                "order": "F" if columns else "C",
                "scalar": isinstance(value, np.generic),
            }
        case None | bool() | int() | float() | str():
            return value
        case RgbdFrame():
            return {"frame": [value.epoch, value.frame_id, _plain(value.T_parent_cam, names)]}
        case Subject():
            return {"subject": names[id(value)]}
        case TrackerConfig():
            return {"config": True}
        case dict():
            return {"dict": [[_plain(k, names), _plain(v, names)] for k, v in value.items()]}
        case list() | tuple() | deque():
            return {type(value).__name__: [_plain(one, names) for one in value]}
    if type(value) is not _CLASSES.get(type(value).__name__):
        raise TypeError(f"a tracker has a {type(value).__name__}, which memory.py does not know")
    return {"class": type(value).__name__, "has": {k: _plain(v, names) for k, v in vars(value).items()}}


def _restored(plain: Any, tracker: Tracker, frames: _Frames) -> Any:
    def each(values: list[Any]) -> Iterator[Any]:
        return (_restored(one, tracker, frames) for one in values)

    match plain:
        case None | bool() | int() | float() | str():
            return plain
        case {"enum": str(kind), "value": value}:
            return _ENUMS[kind](value)
        case {"array": bytes(data), "dtype": str(dtype), "shape": [*shape], "order": "F" | "C" as order}:
            if dtype not in _DTYPES or math.prod(shape) * np.dtype(dtype).itemsize != len(data):
                raise ValueError(f"an array of {dtype} {shape} in {len(data)} bytes")
            array = np.frombuffer(data, dtype).reshape(shape, order=order).copy(order)
            return array[()] if plain["scalar"] else array
        case {"frame": [epoch, frame_id, place]}:
            return frames(epoch, frame_id, _restored(place, tracker, frames))
        case {"subject": str(name)}:
            return tracker._subjects[name]
        case {"config": True}:
            return tracker.config
        case {"dict": [*pairs]}:
            return {k: v for k, v in (tuple(each(pair)) for pair in pairs)}
        case {"list": [*values]}:
            return list(each(values))
        case {"tuple": [*values]}:
            return tuple(each(values))
        case {"deque": [*values]}:
            return deque(each(values))
        case {"class": str(name), "has": dict(attributes)}:
            made: Any = object.__new__(_CLASSES[name])
            for attribute, value in attributes.items():
                object.__setattr__(made, attribute, _restored(value, tracker, frames))
            return made
    raise ValueError(f"{str(plain)[:60]}")
