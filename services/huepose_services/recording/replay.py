"""Plays a recording back on the bus: frames, poses and messages at their times, as if the pipeline ran.

Stamps are moved to now, together, so that ages and intervals are those of the recording. `huepose poses`,
`view` and every subscriber take it for a pipeline; each pass has a camera epoch of its own.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from huepose.datasets.bop import BopScene
from huepose.support.errors import InputError
from huepose_protos import WireError
from huepose_protos.buffers import pack
from huepose_protos.client import kind_of
from huepose_protos.messages import FrameHeader, Message, PoseMessage
from huepose_services.convert import depth_to_wire, intrinsics_to_wire
from huepose_services.recording.writer import MESSAGES, POSES
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import this_clock

_DEPTH_SCALE_M = 0.0001


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
        for record, where in _lines(self.folder / POSES):
            message = _message(record, PoseMessage, where)
            tail = f"pose/{message.object}/{message.instance}"
            yield Event(message.publish_ns, tail=tail, message=message)
        for record, where in _lines(self.folder / MESSAGES):
            tail = str(record.get("key"))
            kind = kind_of(f"huepose/site/camera/{tail}")
            if kind is not None:
                message = _message(record.get("message"), kind, where)
                yield Event(message.publish_ns, tail=tail, message=message)

    @property
    def seconds(self) -> float:
        """From the first to the last event."""
        return (self.events[-1].stamp_ns - self.events[0].stamp_ns) * 1e-9


def _lines(path: Path) -> Iterator[tuple[Any, str]]:
    """JSON objects and where they stand. A last line without its end was never finished."""
    if not path.is_file():
        return
    for number, line in enumerate(path.read_text().split("\n")[:-1], 1):
        where = f"{path}, line {number}"
        yield _object(line, where), where


def _object(line: str, where: str) -> dict[str, Any]:
    try:
        record = json.loads(line)
    except json.JSONDecodeError:
        record = None
    if not isinstance(record, dict):
        raise InputError(where, found=line[:60], expected="a JSON object")
    return record


def _message(record: Any, kind: type[Any], where: str) -> Any:
    try:
        return msgspec.convert(record, kind)
    except (msgspec.ValidationError, WireError, ValueError) as error:
        raise InputError(where, found=str(error)[:200], expected=f"a {kind.__name__}") from None


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
