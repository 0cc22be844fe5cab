"""Listens to a running pipeline and writes what it hears, until the camera is opened anew or the end."""

from __future__ import annotations

import time

from huepose_protos import WireError
from huepose_protos.buffers import frame_images
from huepose_protos.messages import (
    CameraMessage,
    FrameHeader,
    HealthMessage,
    Message,
    ObjectsMessage,
    PoseMessage,
    TruthMessage,
)
from huepose_services.recording.writer import SceneWriter
from huepose_services.runtime.bus import Bus, Place

_COMMIT_EVERY_S = 1.0
# Writing the list of all frames grows with the recording; it may take this share of the time.
_COMMIT_SHARE = 0.03
_GONE_AFTER_S = 1.0


class Recorder:
    """One recording. `finished` says why it is over: the camera was opened anew, or the pipeline is gone."""

    def __init__(self, bus: Bus, writer: SceneWriter, with_frames: bool) -> None:
        self._bus, self._writer = bus, writer
        keys, inbox = bus.keys, bus.inbox
        self._frames = bus.frames() if with_frames else None
        kinds: list[tuple[str, type[Message]]] = [
            (keys.poses, PoseMessage),
            (keys.truth, TruthMessage),
            (keys.objects, ObjectsMessage),
            (keys.camera_info, CameraMessage),
            (keys.health(), HealthMessage),
        ]
        self._queues: list[tuple[Place, type[Message]]] = [
            (inbox.queue(key, wakes=False), kind) for key, kind in kinds
        ]
        self._live = inbox.liveliness(keys.live())
        self._there: set[str] = set()
        self._gone_since: float | None = None
        self._epoch: int | None = None
        self._next_commit = time.monotonic() + _COMMIT_EVERY_S
        self.finished = ""
        self.first_ns: int | None = None
        self.last_ns = 0

    @property
    def seconds(self) -> float:
        """From the first to the last thing that was recorded."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) * 1e-9

    @property
    def missed(self) -> int:
        """Frames that came and were not written."""
        return self._writer.dropped + (0 if self._frames is None else self._frames.skipped)

    def step(self) -> None:
        """Write what arrived."""
        for place, kind in self._queues:
            while (message := self._bus.take(place, kind)) is not None:
                self._take(message)
        if self._frames is not None:
            taken = self._bus.take_with_payload(self._frames, FrameHeader)
            if taken is not None and self._is_same_camera(taken[0].camera_epoch):
                self._frame(*taken)
        self._look_who_is_there()
        if time.monotonic() >= self._next_commit:
            took = self._writer.commit()
            self._next_commit = time.monotonic() + max(_COMMIT_EVERY_S, took / _COMMIT_SHARE)

    def _is_same_camera(self, epoch: int) -> bool:
        if self._epoch is None:
            self._epoch = epoch
        if epoch != self._epoch:
            self.finished = "the camera was opened anew: frames are counted from the start again"
        return epoch == self._epoch

    def _frame(self, header: FrameHeader, payload: bytes) -> None:
        try:
            color, depth = frame_images(header, payload)
        except WireError as error:
            self._bus.refuse(self._bus.keys.frame, error)
            return
        self._writer.frame(header, color, depth)
        self._saw(header.capture_ns)

    def _take(self, message: Message) -> None:
        keys = self._bus.keys
        if isinstance(message, PoseMessage):
            if not self._is_same_camera(message.camera_epoch):
                return
            key = keys.pose(message.object, message.instance)
        elif isinstance(message, HealthMessage):
            key = keys.health(message.worker)
        elif isinstance(message, TruthMessage):
            key = keys.truth
        else:
            key = keys.objects if isinstance(message, ObjectsMessage) else keys.camera_info
        self._writer.message(key, message)
        self._saw(message.publish_ns)

    def _saw(self, stamp_ns: int) -> None:
        self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
        self.last_ns = max(self.last_ns, stamp_ns)

    def _look_who_is_there(self) -> None:
        import zenoh

        while (sample := self._live.take()) is not None:
            key = str(sample.key_expr)
            if sample.kind == zenoh.SampleKind.PUT:
                self._there.add(key)
                self._gone_since = None
            else:
                self._there.discard(key)
                self._gone_since = None if self._there else time.monotonic()
        if self._gone_since is not None and time.monotonic() - self._gone_since > _GONE_AFTER_S:
            self.finished = "the pipeline is gone"
