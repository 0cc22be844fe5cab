"""Plays a recording back on the bus: frames, poses and messages at their times, as if the pipeline ran.

Stamps are moved to now, together, so that ages and intervals are those of the recording. `huepose poses`,
`view` and every subscriber take it for a pipeline; each pass has a camera epoch of its own.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec

from huepose.datasets.bop import BopScene
from huepose.support.errors import InputError
from huepose_protos.buffers import pack
from huepose_protos.client import kind_of
from huepose_protos.messages import FrameHeader, Message, PoseMessage
from huepose_services.convert import depth_to_wire, intrinsics_to_wire
from huepose_services.recording.writer import MESSAGES, POSES
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import this_clock

_DEPTH_SCALE_M = 0.0001
# The longest messages are those with masks.
_LONGEST_LINE = 4 * 1024 * 1024
T = TypeVar("T")
M = TypeVar("M", bound=Message)


@dataclass(frozen=True)
class Event:
    """Something that happened at a stamp: an image of the scene, or a message under the end of its key."""

    stamp_ns: int
    image: int | None = None
    tail: str = ""
    message: Message | None = None


class Recording:
    """A folder that `huepose record` wrote. Raises InputError for one that is something else."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        if not folder.is_dir() or not (folder / POSES).is_file():
            raise InputError(
                folder,
                found="no recording" if folder.is_dir() else "no such folder",
                expected=f"a folder with {POSES}, as huepose record makes it",
                fix="A scene without poses is played by a pipeline with camera.source: bop.",
            )
        has_frames = (folder / "scene_camera.json").is_file()
        self.scene = BopScene(folder) if has_frames else None
        self.events = sorted(self._events(), key=lambda event: event.stamp_ns)
        if not self.events:
            raise InputError(folder, found="an empty recording")

    def _events(self) -> Iterator[Event]:
        if self.scene is not None:
            for image in self.scene.image_ids:
                yield Event(self.scene.stamp_ns(image), image=image)
        for line, where in _lines(self.folder / POSES):
            pose = _message(line, PoseMessage, where)
            yield Event(pose.publish_ns, tail=f"pose/{pose.object}/{pose.instance}", message=pose)
        for line, where in _lines(self.folder / MESSAGES):
            record = _decoded(line, _Keyed, where, "a JSON object with key and message")
            kind = kind_of(f"huepose/site/camera/{record.key}")
            if kind is not None:
                message = _message(record.message, kind, where)
                yield Event(message.publish_ns, tail=record.key, message=message)

    @property
    def seconds(self) -> float:
        """From the first to the last event."""
        return (self.events[-1].stamp_ns - self.events[0].stamp_ns) * 1e-9


class _Keyed(msgspec.Struct):
    """A line of the messages: the end of a key, and what was said under it."""

    key: Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9_-]+(/[a-z0-9_-]+)*$")]
    message: msgspec.Raw


def _lines(path: Path) -> Iterator[tuple[bytes, str]]:
    """Lines and where they stand. A last line without its end was never finished."""
    if not path.is_file():
        return
    try:
        with path.open("rb") as file:
            for number, line in enumerate(iter(lambda: file.readline(_LONGEST_LINE), b""), 1):
                where = f"{path}, line {number}"
                if not line.endswith(b"\n"):
                    if len(line) == _LONGEST_LINE:
                        raise InputError(where, found=f"over {_LONGEST_LINE} bytes", expected="a message")
                    return
                yield line, where
    except OSError as error:
        raise InputError(path, found=error.strerror or str(error), expected="a readable file") from None


def _message(line: bytes | msgspec.Raw, kind: type[M], where: str) -> M:
    return _decoded(line, kind, where, f"a {kind.__name__}")


def _decoded(line: bytes | msgspec.Raw, kind: type[T], where: str, expected: str) -> T:
    try:
        return msgspec.json.decode(line, type=kind)
    except (msgspec.MsgspecError, ValueError, RecursionError, OverflowError) as error:
        raise InputError(where, found=str(error)[:200] or type(error).__name__, expected=expected) from None


class Player:
    """One pass through a recording. Ask `due_ns`, then call `play`."""

    def __init__(self, recording: Recording, bus: Bus, start_ns: int, speed: float) -> None:
        self._recording, self._bus, self._speed = recording, bus, speed
        self._start_ns, self._first_ns = start_ns, recording.events[0].stamp_ns
        self._epoch = secrets.randbits(62)
        self._next = 0

    @property
    def finished(self) -> bool:
        """Whether all was played."""
        return self._next >= len(self._recording.events)

    def due_ns(self) -> int:
        """When the next event is due."""
        return self._moved(self._recording.events[min(self._next, len(self._recording.events) - 1)].stamp_ns)

    def _moved(self, stamp_ns: int) -> int:
        return self._start_ns + round((stamp_ns - self._first_ns) / self._speed)

    def play(self) -> None:
        """Publish the next event."""
        event = self._recording.events[self._next]
        self._next += 1
        if event.image is not None:
            self._frame(event.image)
        elif event.message is not None:
            self._bus.put(self._bus.keys.of_tail(event.tail), self._now(event.message))

    def _now(self, message: Message) -> Message:
        """The message with its stamps moved, on this machine's clock and of this pass's camera."""
        changes: dict[str, Any] = {"publish_ns": self._moved(message.publish_ns)}
        capture_ns = getattr(message, "capture_ns", None)
        if capture_ns is not None:
            # The age is kept, at any speed.
            changes["capture_ns"] = changes["publish_ns"] - (message.publish_ns - capture_ns)
        if getattr(message, "camera_epoch", None) is not None:
            changes["camera_epoch"] = self._epoch
        clock = this_clock()
        if hasattr(message, "clock"):
            changes["clock"] = clock
        if hasattr(message, "clock_id"):
            changes |= {"clock_id": clock.clock_id, "realtime_offset_ns": clock.realtime_offset_ns}
        return msgspec.structs.replace(message, **changes)

    def _frame(self, image: int) -> None:
        scene = self._recording.scene
        assert scene is not None
        frame = scene.frame(image)
        buffers, payload = pack({"color": frame.color, "depth": depth_to_wire(frame.depth, _DEPTH_SCALE_M)})
        stamp_ns = self._moved(frame.stamp_ns)
        header = FrameHeader(
            publish_ns=stamp_ns,
            camera_epoch=self._epoch,
            frame_id=image,
            capture_ns=stamp_ns,
            clock=this_clock(),
            frame=f"{self._bus.keys.camera}_color_optical",
            intrinsics=intrinsics_to_wire(frame.camera, _DEPTH_SCALE_M),
            buffers=buffers,
        )
        self._bus.put_pixels(self._bus.keys.frame, header, payload)
